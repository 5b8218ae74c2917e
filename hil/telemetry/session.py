"""Zenoh sessions as this project wants them: loopback unless told otherwise, no scouting, no shared memory."""

import json
from collections.abc import Sequence

import zenoh

OPEN_TIMEOUT_MS = 2000


def server_config(listen: Sequence[str]) -> zenoh.Config:
    """The sidecar: a router, so that any number of clients reach it and each other through it."""
    config = _common()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", json.dumps(list(listen)))
    config.insert_json5("listen/exit_on_failure", "true")
    return config


def client_config(endpoint: str) -> zenoh.Config:
    """A monitor: reconnects by itself, within half a second, when the sidecar comes back."""
    config = _common()
    config.insert_json5("mode", '"client"')
    config.insert_json5("listen/endpoints", "[]")
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("connect/timeout_ms", "0")
    config.insert_json5("connect/exit_on_failure", "false")
    # A stopped sidecar's kernel still accepts; the default of 10 s is long for somebody who wants to stop the stage.
    config.insert_json5("transport/unicast/open_timeout", str(OPEN_TIMEOUT_MS))
    retry = {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2}
    config.insert_json5("connect/retry", json.dumps(retry))
    return config


def _common() -> zenoh.Config:
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("scouting/gossip/enabled", "false")
    config.insert_json5("transport/shared_memory/enabled", "false")
    return config
