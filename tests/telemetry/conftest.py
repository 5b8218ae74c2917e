"""A sidecar's side of Zenoh, and a client's."""

from collections.abc import Iterator

import pytest
import zenoh

from hil.telemetry.publisher import Publisher
from hil.telemetry.session import client_config
from tests.telemetry.test_sidecar import free_endpoint


@pytest.fixture
def publisher() -> Iterator[Publisher]:
    with Publisher("hil", "rig", [free_endpoint()]) as publisher:
        yield publisher


@pytest.fixture
def session(publisher: Publisher) -> Iterator[zenoh.Session]:
    with zenoh.open(client_config(publisher.listen[0])) as session:
        yield session
