"""Zenoh sessions as this project wants them: loopback unless told otherwise, no scouting, no shared memory, and nothing
allowed to those who connect but to subscribe and to query what is published.
"""

import json
from collections.abc import Sequence
from typing import Any

import zenoh

from hil.telemetry.credentials import AUTHORITY, CERTIFICATE, KEY, SIDECAR, Credentials

OPEN_TIMEOUT_MS = 2000
LARGEST_MESSAGE = 64 * 1024  # bytes that anybody may send to a sidecar; what it publishes itself may be larger
SESSIONS = 256
PENDING = 4096  # links that have not said who they are; each costs a descriptor for ACCEPT_MS
ACCEPT_MS = 1000

# Zenoh's names for messages, as they come in from, and go out to, whoever is connected.
_MAY_ASK = ["declare_subscriber", "query", "declare_liveliness_subscriber", "liveliness_query"]
_MAY_HEAR = ["put", "reply", "declare_queryable", "liveliness_token"]


def server_config(listen: Sequence[str], keys: str, credentials: Credentials | None = None) -> zenoh.Config:
    """The sidecar: a router, so that any number of clients reach it. keys: what it alone
    publishes, a key expression."""
    config = _common(credentials)
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", json.dumps(list(listen)))
    config.insert_json5("listen/exit_on_failure", "true")
    config.insert_json5("access_control", json.dumps(access_control(keys)))
    config.insert_json5("transport/unicast/max_sessions", str(SESSIONS))
    config.insert_json5("transport/unicast/accept_pending", str(PENDING))
    config.insert_json5("transport/unicast/accept_timeout", str(ACCEPT_MS))
    config.insert_json5("transport/link/rx/max_message_size", str(LARGEST_MESSAGE))
    return config


def router_config(listen: Sequence[str], sidecar: str, credentials: Credentials) -> zenoh.Config:
    """A router between a rig's sidecar and its monitors (deploy/zenoh/router.py): only what bears the sidecar's
    certificate may publish through it.
    """
    config = server_config(listen, "**", credentials)
    config.insert_json5("connect/endpoints", json.dumps([sidecar]))
    config.insert_json5("connect/timeout_ms", "-1")
    config.insert_json5("connect/exit_on_failure", "false")
    access = access_control("**")
    access["rules"].append(
        {"id": "tell", "permission": "allow", "flows": ["ingress"], "messages": _MAY_HEAR, "key_exprs": ["**"]}
    )
    access["rules"].append(
        {"id": "pass on", "permission": "allow", "flows": ["egress"], "messages": _MAY_ASK, "key_exprs": ["**"]}
    )
    access["subjects"].append({"id": "sidecar", "cert_common_names": [SIDECAR]})
    access["policies"].append({"rules": ["tell", "pass on"], "subjects": ["sidecar"]})
    config.insert_json5("access_control", json.dumps(access))
    return config


def access_control(keys: str) -> dict[str, Any]:
    """Zenoh's access control for those who connect: denied is all that is not named here.

    They may ask with any expression, as `hil/*/status` covers more than one rig's keys; they hear of `keys` alone.
    """
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [
            {"id": "ask", "permission": "allow", "flows": ["ingress"], "messages": _MAY_ASK, "key_exprs": ["**"]},
            {"id": "hear", "permission": "allow", "flows": ["egress"], "messages": _MAY_HEAR, "key_exprs": [keys]},
        ],
        "subjects": [{"id": "everybody"}],
        "policies": [{"rules": ["ask", "hear"], "subjects": ["everybody"]}],
    }


def client_config(endpoint: str, credentials: Credentials | None = None) -> zenoh.Config:
    """A monitor: reconnects by itself, within half a second, when the sidecar comes back."""
    config = _common(credentials)
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


def _common(credentials: Credentials | None) -> zenoh.Config:
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("scouting/gossip/enabled", "false")
    config.insert_json5("transport/shared_memory/enabled", "false")
    if credentials:
        certificate, key = credentials.path(CERTIFICATE), credentials.path(KEY)
        tls = {
            "root_ca_certificate": credentials.path(AUTHORITY),
            "enable_mtls": True,
            "verify_name_on_connect": False,
            "listen_certificate": certificate,
            "listen_private_key": key,
            "connect_certificate": certificate,
            "connect_private_key": key,
            "close_link_on_expiration": True,
        }
        config.insert_json5("transport/link/tls", json.dumps(tls))
    return config
