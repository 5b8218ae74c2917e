"""What is in front of an emulated camera, in a file that the emulator's process writes and a program of images reads.

One fixed record in shared memory. The writer makes its count odd, writes, and makes it even again (a seqlock), so that
a reader never takes half of an old scene and half of a new one. It relies on stores becoming visible in program order,
as on x86-64.
"""

import os
import struct
import time
from pathlib import Path
from typing import Final

from drivers.base.runtime import create_private, open_private
from drivers.base.shared_map import map_shared, unmap
from sim_plant.emulator import EmulatedStage
from sim_plant.nodes.picture import Scene

_MAGIC: Final = b"HILSCEN1"
_RECORD: Final = struct.Struct("<8sQq9dqq")  # magic, count, ns, doubles of the scene, has a cell, number
_COUNT: Final = struct.Struct("<Q")
_TRIES: Final = 1000
_EVERY_NS: Final = 2_000_000


def scene_of(stage: EmulatedStage, axes: tuple[int, int, int]) -> Scene:
    """Of the stage at `now_ns`. axes: places of the two across and of the one along."""
    dish, positions = stage.dish, stage.tips[0]
    x, y, z = (positions[axis] for axis in axes)
    if dish is None:
        return Scene((x, y, z))
    missing, cell = abs(dish.tip_error), dish.under
    if cell is None:
        return Scene((x, y, z), missing)
    pressed = dish.force > 0.0 and cell.pierced_ns is None
    dimple = max(0.0, (z - cell.top) * dish.direction) if pressed else 0.0
    return Scene((x, y, z), missing, (cell.x + cell.moved, cell.y), dish.radius, dimple, dish.bolus, cell.number)


class ScenePage:
    """The writer's end. Raises OSError."""

    def __init__(self, path: Path) -> None:
        temporary = path.with_name(f"{path.name}.{os.getpid()}.new")
        fd = create_private(temporary)
        try:
            os.posix_fallocate(fd, 0, _RECORD.size)
            self._map = map_shared(fd, _RECORD.size)
        finally:
            os.close(fd)
        os.replace(temporary, path)
        self._count = 0
        self._written_ns = 0

    def update(self, stage: EmulatedStage, axes: tuple[int, int, int]) -> None:
        """The scene as it is now, not more often than every 2 ms."""
        if stage.now_ns - self._written_ns >= _EVERY_NS:
            self._written_ns = stage.now_ns
            self.write(scene_of(stage, axes), stage.now_ns)

    def write(self, scene: Scene, now_ns: int) -> None:
        """now_ns: when it is so, CLOCK_MONOTONIC."""
        cell = scene.cell or (0.0, 0.0)
        count = self._count + 2
        record = _RECORD.pack(
            _MAGIC, count, now_ns, *scene.tip, scene.missing, *cell, scene.radius, scene.dimple, scene.bolus,
            scene.cell is not None, scene.number,
        )  # fmt: skip
        _COUNT.pack_into(self._map, 8, count - 1)
        self._map[16 : _RECORD.size] = record[16:]
        self._map[:8] = _MAGIC
        _COUNT.pack_into(self._map, 8, count)
        self._count = count

    def close(self) -> None:
        """Unmap it; the file stays."""
        unmap(self._map)


class SceneReader:
    """The reader's end. Raises OSError where there is no such file, ValueError where it is none."""

    def __init__(self, path: Path) -> None:
        fd = open_private(path, os.O_RDWR)
        try:
            if os.fstat(fd).st_size < _RECORD.size:
                raise ValueError("not a scene of this version")
            self._map = map_shared(fd, _RECORD.size)
        finally:
            os.close(fd)

    def read(self) -> tuple[Scene, int]:
        """The newest scene, and when it was so, ns. Raises ValueError where none was written, or its writer has been
        stopped in the midst.
        """
        for _ in range(_TRIES):
            magic, count, now_ns, *numbers, has_cell, number = _RECORD.unpack_from(self._map)
            if magic == _MAGIC and not count % 2 and _COUNT.unpack_from(self._map, 8)[0] == count:
                x, y, z, missing, *cell, radius, dimple, bolus = numbers
                place = (cell[0], cell[1]) if has_cell else None
                return Scene((x, y, z), missing, place, radius, dimple, bolus, number), now_ns
            time.sleep(0)
        raise ValueError("no whole scene")

    def close(self) -> None:
        """Unmap it."""
        unmap(self._map)
