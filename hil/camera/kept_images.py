"""The images that were looked at, in a folder, each under the number that its frames carry on the bus."""

from pathlib import Path

import numpy as np

from drivers.base.named_file import naming
from hil.camera.contract import Pixels


class KeptImages:
    """folder: made where it is missing; images that it has already stay, and no new one takes their place.

    Raises OSError naming the file.
    """

    def __init__(self, folder: Path) -> None:
        with naming(folder):
            folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder

    def keep(self, pixels: Pixels, number: int, exposed_ns: int) -> None:
        """One image. number: of the image among the new ones; its frames have it modulo 256. exposed_ns: the instant
        that they say.
        """
        path = self._folder / f"{number:08d}-{exposed_ns}.npy"
        with naming(path), path.open("xb") as file:
            np.save(file, pixels, allow_pickle=False)
