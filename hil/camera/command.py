"""`hil camera RIG --source SOURCE`: images in, frames of the rig's [sensors] out, until Ctrl-C."""

import contextlib
import math
import shlex
import sys
import time
from pathlib import Path
from typing import Annotated

import typer

from drivers.base.runtime import RuntimeDirectoryError
from drivers.bus.port import Port, PortError
from drivers.bus.segmented_port import open_segments
from hil.camera.calibrate import Calibrator
from hil.camera.calibration import Calibration, UncalibratedError, calibration_path, keep, kept
from hil.camera.contract import CameraError, Features, Image, Seen, Source
from hil.camera.encoders import Encoders
from hil.camera.kept_images import KeptImages
from hil.camera.node import CameraNode, detector_of
from hil.camera.readings import FirstSeen, Interpreter
from hil.camera.sources import KINDS, open_source
from hil.cli.exit_status import EXIT_UNAVAILABLE
from hil.cli.options import Overrides, RigFile
from hil.cli.quantity import quantity
from hil.cycle.goal import GoalRefusedError, MotionError
from hil.live.runtime_paths import AlreadyServedError, runtime_paths, sole
from hil.operate.moving import motion
from hil.rig.file import load_rig
from hil.rig.layout import host_layout
from hil.rig.schema import RigConfig, RigError
from hil.rig.sensors import check_sensors
from hil.telemetry.command_client import NoGatewayError
from sim_plant.process import StopSignals

_FIRST_S = 10.0  # in which the first image must come


def camera(
    rig: RigFile,
    source: Annotated[str, typer.Option(metavar="SOURCE", help="; ".join(KINDS.values()), show_default=False)],
    overrides: Overrides = None,
    *,
    seconds: Annotated[float | None, typer.Option(min=0.1, max=1e6, help="end after this time")] = None,
    do_calibrate: Annotated[
        bool, typer.Option("--calibrate", help="move the two axes by steps, find scale and tip, keep them, and end")
    ] = False,
    step: Annotated[str, typer.Option(help="of --calibrate, such as 0.1mm")] = "0.1mm",
    keep_images: Annotated[
        Path | None, typer.Option("--keep", metavar="FOLDER", help="keep each image there, by its number and instant")
    ] = None,
    take: Annotated[bool, typer.Option("--take", help="--calibrate: also where another client moves the rig")] = False,
) -> None:
    """Make readings of images: find pipette and cell, and send what [camera] says as frames of [sensors], until Ctrl-C.

    --calibrate moves a running rig by two steps of the camera's axes at most, from where it stands.
    Exit status 69: no camera, bus, calibration or running rig; the reason is told.
    """
    config = load_rig(rig, overrides or [])
    if config.camera is None:
        raise RigError([f"{rig}: no [camera]; hil explain camera"])
    try:
        fd = host_layout(config, rig.parent).fd
        check_sensors(config, host_layout(config, rig.parent))
        detector = detector_of(config.camera)
    except ValueError as error:
        raise RigError([f"{rig}: {error}"]) from None
    length = _length(step)
    try:
        with contextlib.closing(open_source(source, config)) as images:
            if do_calibrate:
                _calibrate(config, images, detector, length, take, fd)
                return
            _serve(config, images, detector, seconds, fd, keep_images)
    except UncalibratedError as error:
        again = shlex.join(["hil", "camera", str(rig), "--source", source, "--calibrate"])
        print(f"hil camera: {error}; calibrate: {again}", file=sys.stderr)
        raise typer.Exit(EXIT_UNAVAILABLE) from None
    except (CameraError, PortError, RuntimeDirectoryError, AlreadyServedError, MotionError, NoGatewayError) as error:
        print(f"hil camera: {error}", file=sys.stderr)
        raise typer.Exit(EXIT_UNAVAILABLE) from None
    except GoalRefusedError as error:
        print(f"hil camera: {error}", file=sys.stderr)
        raise typer.Exit(1) from None


def _length(step: str) -> float:
    try:
        length = quantity("step", step, "linear")
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--step") from None
    if not 1e-6 <= length <= 0.01:
        raise typer.BadParameter(f"{step}: from 1um to 10mm", param_hint="--step")
    return length


def _calibrate(rig: RigConfig, images: Source, detector: Features, step: float, take: bool, fd: bool) -> None:
    """Sends readings meanwhile, by the pixel that the rig file states and against the first place of the tip: a rig
    whose sensors are silent stops.
    """
    assert rig.camera is not None
    with contextlib.ExitStack() as stack:
        stack.enter_context(sole(runtime_paths(rig.name), "camera"))
        port = stack.enter_context(contextlib.closing(open_segments(rig.bus, role="device", fd=fd)))
        x, y = (rig.axis_names.index(name) for name in rig.camera.axes)
        encoders = stack.enter_context(contextlib.closing(Encoders(rig.name, (x, y))))
        mover = stack.enter_context(motion(rig.name, take=take, activate=False))
        node = CameraNode(rig, detector, FirstSeen(rig.camera), encoders)

        def look(image: Image) -> tuple[int, Seen] | None:
            looked = node.look(image)
            for frame in node.told(*looked) if looked else ():
                port.send(frame)
            port.drain(time.monotonic_ns())
            return looked

        def tell(text: str) -> None:
            print(f"hil camera: {text}", flush=True)

        found = Calibrator(rig, mover, images, look, tell).run(step)
    try:
        path = keep(rig, found)
    except OSError as error:
        raise CameraError(f"{calibration_path(rig)}: cannot be kept: {error.strerror}") from None
    print(described(found))
    print(f"kept in {path}")


def described(found: Calibration) -> str:
    """A calibration in words."""
    carried = "the axes carry the pipette" if found.moves else "the pipette stands still in the picture"
    mirrored = ", mirrored" if found.mirrored else ""
    return (
        f"{found.pixel * 1e6:.4g} um per pixel, turned by {math.degrees(found.turn):.2f} deg{mirrored}; {carried}; "
        f"tip at {found.tip.column:.1f}, {found.tip.row:.1f} px; {found.left:.2f} px RMS over {found.images} images"
    )


def _serve(
    rig: RigConfig, images: Source, detector: Features, seconds: float | None, fd: bool, folder: Path | None
) -> None:
    assert rig.camera is not None
    camera = rig.camera
    with contextlib.ExitStack() as stack:
        stop = stack.enter_context(StopSignals())
        stack.enter_context(sole(runtime_paths(rig.name), "camera"))
        first = _first(images, stop)
        if first is None:
            return
        calibration = kept(rig, first.pixels.shape) if camera.needs_calibration else None
        encoders = None
        if calibration is not None:
            x, y = (rig.axis_names.index(name) for name in camera.axes)
            encoders = stack.enter_context(contextlib.closing(Encoders(rig.name, (x, y))))
        node = CameraNode(
            rig, detector, Interpreter(camera, calibration), encoders, KeptImages(folder) if folder else None
        )
        port = stack.enter_context(contextlib.closing(open_segments(rig.bus, role="device", fd=fd)))
        where = ", ".join(f"{name} ({quantity})" for quantity, name in camera.sends.items())
        print(f"hil camera: {rig.name} on {rig.bus.channels[0]}: sends {where}", flush=True)
        try:
            _send_all(node, images, port, stop, seconds)
        finally:
            _tell(node, list(camera.sends))


def _first(images: Source, stop: StopSignals) -> Image | None:
    """The first image; None where the end was asked for before. Raises CameraError."""
    until = time.monotonic() + _FIRST_S
    while not stop.seen:
        if image := images.read():
            return image
        if time.monotonic() > until:
            raise CameraError(f"no image within {_FIRST_S:g} s")
    return None


def _send_all(node: CameraNode, images: Source, port: Port, stop: StopSignals, seconds: float | None) -> None:
    until = math.inf if seconds is None else time.monotonic() + seconds
    with contextlib.suppress(EOFError):
        while not stop.seen and time.monotonic() < until:
            image = images.read()
            for frame in node.frames(image) if image else ():
                port.send(frame)
            port.drain(time.monotonic_ns())


def _tell(node: CameraNode, quantities_sent: list[str]) -> None:
    counts, old = node.counts, node.exposures.old
    shares = ", ".join(f"{name} in {counts.seen[name]}" for name in quantities_sent)
    print(f"hil camera: {counts.images} images, {old} that were there before; seen: {shares}", flush=True)
