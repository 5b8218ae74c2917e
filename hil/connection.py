"""A running rig in Python: `hil.connect`. What is said and asked goes through its sidecar, as in `hil monitor`."""

import contextlib
import os
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np

from hil.cycle.command_desk import LOADS
from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.events.event import Event as Happened
from hil.live.mapped_file import Closing
from hil.live.task_loading import law_document, task_document
from hil.rig.file import build_rig, law_of_file, task_of_file
from hil.rig.schema import RigConfig
from hil.runs.columns import Columns, Event
from hil.runs.mover import Mover
from hil.runs.remote import remote_motion
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.client import NoSidecarError, RigClient, find_endpoint
from hil.telemetry.command_client import CommandClient, NoGatewayError, Verdict, remote_client
from hil.telemetry.credentials import Credentials, CredentialsError
from hil.telemetry.event_codec import decode
from hil.telemetry.remote_link import RemoteLink

FIRST_S = 5.0


class LiveRig(Closing):
    """A running rig on this machine, or elsewhere: watched at `endpoint`, commanded and moved at `commands`.

    Use it in a `with` block. Raises NoSidecarError where no sidecar of that rig answers, CredentialsError.
    """

    def __init__(
        self, name: str, endpoint: str | None = None, key: str = "hil", *, commands: str | None = None,
        credentials: str | os.PathLike[str] | None = None,
    ) -> None:  # fmt: skip
        """commands: "host:port" of the sidecar's --commands-from. credentials: directory with an operator's."""
        self.name = name
        self._logged = False
        self._credentials = Credentials(Path(credentials)) if credentials else None
        if commands and self._credentials is None:
            raise CredentialsError("commands from elsewhere need credentials: a directory with an operator's")
        self._commands = commands
        self._client = RigClient(endpoint or find_endpoint(name), key, name, self._credentials)
        with contextlib.ExitStack() as undo:
            undo.callback(self._client.close)
            self._client.wait_status(FIRST_S)
            undo.pop_all()

    def status(self, timeout_s: float = FIRST_S) -> pb.Status:
        """The next status, of ten a second: state, fault, positions, forces, lateness. Raises NoSidecarError."""
        return self._client.wait_status(timeout_s)

    def motion_status(self, timeout_s: float = FIRST_S) -> pb.Motion:
        """What the axes do now, of 50 messages a second: position, velocity, target, motion, goal, moving, in_position,
        limited, lag, lease. Positions in m (rad). Raises NoSidecarError.
        """
        return self._client.wait_motion(timeout_s)

    def telemetry(self, timeout_s: float = FIRST_S) -> Iterator[Columns]:
        """Every tick from now on, in batches of columns as hil.Run.columns has them: (ticks,) or (ticks, n_axes).

        Rounded as docs/recording.md says; scheduled_ns and now_ns count from the control process's slot 0. Without end.
        A reader that is too slow loses the oldest ticks, and column `index` then has a gap. Raises NoSidecarError where
        none comes for that long.
        """
        while True:
            yield cast(Columns, self._client.wait_ticks(timeout_s))

    def events(self, timeout_s: float = FIRST_S) -> Iterator[Event]:
        """Every change of the state and of the latched fault from now on; the first is the state as it is.

        time: s, since the control process's slot 0. Without end. Raises NoSidecarError as `telemetry`.
        """
        last: dict[str, int] = {"fault": int(Fault.NONE)}
        for columns in self.telemetry(timeout_s):
            yield from _changes(columns, last)

    def log(self, timeout_s: float = FIRST_S) -> list[Happened]:
        """Events whole (hil.events.event.Event): tick, axis, measured value, limit, cause, what to do next.

        The first call gives all the sidecar keeps, later ones what has come since, and do not wait. Raises
        NoSidecarError.
        """
        found = self._client.events() if self._logged else self._client.wait_events(timeout_s)
        self._logged = True
        return [decode(event) for event in found]

    def wait_for(self, state: str, timeout_s: float = 30.0) -> pb.Status:
        """The first status in that state, such as "READY". Raises TimeoutError, NoSidecarError."""
        until = time.monotonic() + timeout_s
        while time.monotonic() < until:
            status = self.status()
            if status.state == state:
                return status
        raise TimeoutError(f"{self.name} is {status.state}, fault {status.fault}, not {state}, after {timeout_s:g} s")

    def command(self, action: str) -> Verdict:
        """Ask the control process: activate, activate_hold, stop, reset, home, estop, shutdown or heartbeat; its
        verdict. Another task goes by `load_task`, another law by `set_law`.

        accepted: whether it did; reason: why not; state: after it. Raises ValueError for another word, NoGatewayError
        where nobody takes it; `hil estop` then still stops the rig.
        """
        kinds = {kind.name.lower(): kind for kind in CommandKind if kind not in LOADS}
        if action not in kinds:
            raise ValueError(f"{action!r}: the commands are {', '.join(kinds)}")
        with self._commander() as client:
            return client.command(kinds[action])

    def _commander(self) -> CommandClient:
        if self._commands and self._credentials:
            return remote_client(self._commands, self._credentials)
        return _at_hand(self.name)

    def load_task(self, task: str | os.PathLike[str] | dict[str, Any], *, overrides: Sequence[str] = ()) -> Verdict:
        """Load another task while the rig is at rest, READY or held for goals. task: a CSV or NPZ file with a path, a
        TOML file with a table [task], or such a table. overrides: task.key=value. It is checked from where the stage
        stands, and lasts until the control process ends. Held, a rig takes paths through points alone.

        Raises RigError for what is no task of this rig, NoGatewayError as `command`.
        """
        rig = self._rig()
        if isinstance(task, dict):
            chosen = build_rig({**rig.model_dump(mode="json"), "task": task}, overrides).task
        else:
            chosen = task_of_file(rig, Path(task), overrides)
        document = task_document(chosen)
        with self._commander() as client:  # only now: who says nothing for long loses the connection
            return client.load_task(document)

    def set_law(
        self, law: str | os.PathLike[str] | dict[str, Any] | None = None, *, gains: dict[str, Any] | None = None
    ) -> Verdict:
        """Another law, or other gains, while the rig is at rest, READY or held for goals. law: a TOML file with a table
        [law], or such a table; None: that of the rig file. gains: of that law, instead of those it has there.

        The loop is checked as by `hil check`, and an unstable one refused. Under torque the force goes on without a
        step. The law lasts until the control process ends. Only hil's own laws are set, and no law that learns. Raises
        RigError for what is no law of this rig, NoGatewayError as `command`.
        """
        rig = self._rig()
        if isinstance(law, dict):
            chosen = build_rig({**rig.model_dump(mode="json"), "law": law}).law
        else:
            chosen = law_of_file(rig, Path(law) if law is not None else None)
        document = law_document(chosen.model_copy(update={"gains": {**chosen.gains, **(gains or {})}}))
        with self._commander() as client:
            return client.set_law(document)

    def _rig(self) -> RigConfig:
        if self._commands and self._credentials:
            with RemoteLink(self._commands, self._credentials) as link:
                return link.rig
        with _at_hand(self.name) as client:
            return client.rig()

    def motion(self, *, take: bool = False) -> Mover:
        """Move it: as `hil.motion`, of this rig, also from elsewhere. Raises MotionError as well where it is not heard
        there.
        """
        if not (self._commands and self._credentials):
            return _motion_at_hand(self.name, take=take)
        return remote_motion(self._commands, self._credentials, take=take)

    def close(self) -> None:
        """Leave; the rig goes on."""
        self._client.close()


def connect(
    name: str, endpoint: str | None = None, *, commands: str | None = None,
    credentials: str | os.PathLike[str] | None = None,
) -> LiveRig:  # fmt: skip
    """A running rig by its name. endpoint: of a sidecar elsewhere, tls/10.0.0.5:7447. commands: where that takes
    commands and goals, 10.0.0.5:7448. credentials: directory with an operator's. Raises NoSidecarError,
    CredentialsError.
    """
    return LiveRig(name, endpoint, commands=commands, credentials=credentials)


@contextlib.contextmanager
def _of_hil_itself() -> Iterator[None]:
    """Raises NoGatewayError where only hil-client is installed."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise NoGatewayError(
            f"{error.name} is not part of hil-client, which moves rigs on other machines: give `commands` and "
            "`credentials`, or install hil"
        ) from None


def _at_hand(name: str) -> CommandClient:
    with _of_hil_itself():
        from hil.operate.command import at_hand
    return at_hand(name)


def _motion_at_hand(name: str, *, take: bool) -> Mover:
    with _of_hil_itself():
        from hil.operate.moving import motion
    return motion(name, take=take)


def _changes(columns: Columns, last: dict[str, int]) -> Iterator[Event]:
    """Where state or fault are other than the tick before; last: what they were, kept up to date."""
    found = []
    for name, kind, column in (("state", State, columns["state"]), ("fault", Fault, columns["fault"])):
        values = column.astype(np.int64)
        before = np.concatenate([[last.get(name, -1)], values[:-1]])
        for place in np.flatnonzero(values != before).tolist():
            value = kind(int(values[place]))
            if name == "state" or value:
                found.append(Event(float(columns["scheduled_ns"][place]) * 1e-9, f"{name} {value.name}"))
        if len(values):
            last[name] = int(values[-1])
    yield from sorted(found)


__all__ = ["LiveRig", "NoGatewayError", "NoSidecarError", "Verdict", "connect"]
