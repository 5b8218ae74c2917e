"""Which source files are mutated, and which tests must notice: one table, by room.

Each room's tests come cheapest first, its own before those of whole runs; what is `slow`, `live` or needs a machine of
its own does not take part, so that a mutant is killed or not whatever else the machine does.
"""

from pathlib import Path
from typing import NamedTuple

_PAGES = "tests/project/test_docs.py"  # tables in code, with every range, are on generated pages
_RUNS = ("tests/virtual/test_reference.py",)  # whole runs, each frame of them
_LOCKSTEP = ("tests/virtual/test_lockstep.py",)


# Seconds each, and whatever they see others see as well: left out, so that a mutant that lives costs no minutes.
LEFT_OUT = (
    "however_long_the_error_lasts", "however_long_that_took", "never_returns", "1200_random_sets", "any_bit_wrong",
    "margins_that_are_shown",
)  # fmt: skip


class Room(NamedTuple):
    """sources: files or folders. tests: likewise, in the order in which they run."""

    sources: tuple[str, ...]
    tests: tuple[str, ...]


ROOMS = {
    "cycle": Room(
        ("hil/cycle", "hil/events"),
        ("tests/cycle/test_state_machine.py", "tests/cycle/test_gate.py", "tests/cycle",
         "tests/telemetry/test_recorder.py", "tests/events", _PAGES, *_RUNS,
         *_LOCKSTEP, "tests/virtual/test_replay.py"),
    ),
    "plug-ins": Room(
        ("hil/control/laws/users.py", "hil/control/law_registry.py", "drivers/base/plugins.py",
         "drivers/base/package_digest.py", "drivers/base/call_limit.py", "drivers/base/guard.py",
         "drivers/base/named_file.py"),
        ("tests/drivers/base/test_plugin_folder.py", "tests/drivers/base/test_package_digest.py",
         "tests/drivers/base/test_call_limit.py", "tests/drivers/base/test_guard.py",
         "tests/drivers/base/test_named_file.py", "tests/control/test_user_laws.py", "tests/rig/test_user_tasks.py",
         "tests/control/test_laws_gone_wrong.py",
         "tests/control/test_laws_per_element.py",
         "tests/virtual/test_installed_law.py", "tests/control/test_laws.py", "tests/virtual/test_user_layout.py"),
    ),
    "laws": Room(
        ("hil/control/laws", "hil/control/gain.py", "hil/control/number.py",
         "hil/control/nominal_model.py"),
        ("tests/control/test_law_reference.py", "tests/control/test_bounded_disturbance.py",
         "tests/control/test_breakaway.py",
         "tests/control/test_structured_filter.py",
         "tests/control/test_presliding_kalman.py", "tests/control/test_friction_wave.py",
         "tests/control/test_iterative_learning.py", "tests/control/test_repeat_memory.py",
         "tests/control/test_other_modes.py", *_RUNS,
         "tests/control/test_handover.py", "tests/live/test_law_setting.py",
         "tests/control/test_laws.py", "tests/control/test_gain.py", _PAGES, "tests/control/test_user_laws.py",
         "tests/control/test_laws_gone_wrong.py",
         "tests/virtual/test_learnt.py", "tests/live/test_kept_learnt.py"),
    ),
    "trajectories": Room(
        ("hil/control/trajectories", "hil/control/setpoints.py"),
        ("tests/control/test_rows.py",
         "tests/control/test_trajectories.py", "tests/control/test_setpoints.py", "tests/control/test_fitted_spline.py",
         "tests/control/test_blends.py", "tests/control/test_task_paths.py", "tests/control/test_path_files.py",
         "tests/live/test_task_file.py",
         *_RUNS, *_LOCKSTEP),
    ),
    "plans": Room(("hil/control/plans",), ("tests/control/plans",)),
    "motions": Room(
        ("hil/control/motion", "drivers/outputs"),
        ("tests/control/motion", "tests/cycle/test_decided_motion.py", "tests/virtual/test_output_kinds.py"),
    ),
    "sensors": Room(
        ("drivers/sensors",),
        ("tests/drivers/sensors", "tests/cycle/test_readings.py", "tests/virtual/test_sensor_kinds.py"),
    ),
    "eds": Room(("drivers/eds",), ("tests/drivers/eds",)),
    "estimator": Room(
        ("hil/control/estimator", "hil/control/error_map.py"),
        ("tests/control/test_estimator.py", "tests/control/test_gains_cache.py", "tests/control/test_error_map.py",
         "tests/control/test_user_estimators.py", "tests/virtual/test_user_layout.py", *_RUNS, *_LOCKSTEP),
    ),
    "stability": Room(
        ("hil/analysis",),
        ("tests/analysis/test_stability.py", "tests/analysis/test_measures.py", "tests/analysis/test_feasibility.py",
         "tests/analysis/test_figures_of_merit.py",
         "tests/analysis/test_restoring.py", "tests/analysis/test_corner_dynamics.py",
         "tests/analysis/test_loop_corners.py", "tests/rig/test_checks.py",
         "tests/analysis/test_start_ranges.py", "tests/analysis/test_learning_check.py",
         "tests/virtual/test_ideal_microscope.py"),
    ),
    "live": Room(
        ("hil/live/loop.py", "hil/live/ring.py", "hil/live/mailbox.py"),
        ("tests/live/test_ring.py", "tests/live/test_mailbox.py", "tests/live/test_loop.py", "tests/live",
         "tests/telemetry/test_commands.py", "tests/telemetry/test_sidecar.py"),
    ),
    "bus": Room(
        ("drivers/bus",),
        ("tests/drivers/bus", "tests/drivers/base/test_runtime.py", "tests/drivers/base/test_text_file.py",
         "tests/drivers/test_native.py"),
    ),
    "layouts": Room(
        ("drivers/protocols", "drivers/families", "drivers/frame.py", "drivers/frame_length.py"),
        ("tests/drivers/test_frame.py", "tests/drivers/test_frame_length.py",
         "tests/drivers/protocols/test_segments.py",
         "tests/drivers/protocols/test_host_conversations.py", "tests/drivers/families/cia402/test_drive_plans.py",
         "tests/drivers/protocols", "tests/drivers/families",
         "tests/cycle/test_protocol_tracking.py", "tests/sim_plant/test_drive.py", *_RUNS,
         "tests/operate/test_drives.py", "tests/operate/test_bus_tool.py", "tests/virtual/test_user_layout.py"),
    ),
    "wire": Room(("drivers/wire",), ("tests/drivers/wire", "tests/sim_plant/test_injector.py", *_RUNS)),
    "physics": Room(("sim_plant/physics",), ("tests/sim_plant", "tests/rig/test_plant.py", *_RUNS)),
    "drives": Room(
        ("sim_plant/drives",), ("tests/sim_plant/test_conversations.py", "tests/sim_plant/test_drive.py",
         "tests/drivers/protocols", "tests/drivers/families", "tests/sim_plant",
         "tests/virtual/test_seeded_mistakes.py", *_RUNS)
    ),
    "adapters": Room(  # the others need packages that are not in this environment
        ("hil/adapters/cdr.py", "hil/adapters/ros_types.py", "hil/adapters/ros_trajectory.py", "hil/adapters/ros2.py"),
        ("tests/adapters/test_ros2.py",),
    ),
    "telemetry": Room(
        ("hil/telemetry/gateway.py", "hil/telemetry/recorder.py", "hil/telemetry/motion_watch.py",
         "hil/telemetry/cell_watch.py"),
        ("tests/telemetry", "tests/operate/test_events_told.py"),
    ),
    "page": Room(
        ("hil/page/access.py", "hil/page/guard.py", "hil/page/frames.py", "hil/page/signals.py",
         "hil/page/ring_feed.py"),
        ("tests/page/test_access.py", "tests/page/test_signals.py", "tests/page/test_ring_feed.py", "tests/page"),
    ),
    "camera": Room(("hil/camera", "hil/rig/camera.py"), ("tests/camera",)),
    "injection": Room(
        ("hil/studies/inject/sheet.py", "hil/studies/inject/requests.py", "hil/operate/check_sensor.py"),
        ("tests/studies/test_inject_batches.py", "tests/operate/test_check_sensor.py"),
    ),
    "admission": Room(
        ("hil/rig", "drivers/config.py", "drivers/bus_load", "sim_plant/config.py", "sim_plant/axis_config.py"),
        ("tests/rig", "tests/drivers/base/test_toml_file.py", "tests/drivers/base/test_text_file.py",
         "tests/drivers/bus_load",
         "tests/operate/test_new.py", _PAGES, "tests/control/test_path_files.py", "tests/control/test_task_paths.py",
         *_RUNS, "tests/drivers/protocols/test_mounting.py", "tests/drivers/families/cia402/test_drive_profiles.py"),
    ),
}  # fmt: skip


def sources_of(root: Path, name: str) -> list[str]:
    """The files of a room; of one that several name, the first one's."""
    taken = {file for other in list(ROOMS)[: list(ROOMS).index(name)] for file in _sources(root, other)}
    return [file for file in _sources(root, name) if file not in taken]


def _sources(root: Path, name: str) -> list[str]:
    return [file for source in ROOMS[name].sources for file in python_files(root, source)]


def python_files(root: Path, path: str) -> list[str]:
    """A file, or all sources below a folder, relative to `root`."""
    place = root / path
    files = [place] if place.is_file() else sorted(place.rglob("*.py"))
    return [str(file.relative_to(root)) for file in files if not file.name.endswith("_pb2.py")]


def files_to_run(root: Path, room: Room, source: str) -> list[str]:
    """The room's test files, each once: first those named after the source file or its folder, then in table order."""
    found = []
    for path in room.tests:
        found += [file for file in python_files(root, path) if Path(file).name.startswith("test_")]
    names = {Path(source).stem, Path(source).parent.name}
    return sorted(dict.fromkeys(found), key=lambda file: Path(file).stem.removeprefix("test_") not in names)
