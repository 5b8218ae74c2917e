"""Contact and puncture on a force signal, one sample a tick."""

from collections import deque
from math import inf


class Contact:
    """A rise of the mean, by the cumulative sum of Page (Biometrika 41, 1954), on samples over their noise.

    drift: in noise, half the step that is found soonest. threshold: in noise. onset: samples ago that the sum began to
    rise.
    """

    def __init__(self, drift: float, threshold: float) -> None:
        self._drift, self._threshold = drift, threshold
        self.restart()

    def restart(self) -> None:
        """Nothing has been seen."""
        self._sum = 0.0
        self.onset = 0

    def take(self, sample: float) -> bool:
        """A sample over its noise; whether it is certain."""
        self._sum = max(0.0, self._sum + sample - self._drift)
        self.onset = self.onset + 1 if self._sum > 0.0 else 0
        return self._sum > self._threshold


class Puncture:
    """A drop from the greatest of the last samples: by a share of it, and by more than noise makes.

    window: samples. share: of the greatest. least: in the unit of the samples.
    """

    def __init__(self, window: int, share: float, least: float) -> None:
        self._recent: deque[float] = deque(maxlen=window)
        self._share, self._least = share, least
        self.peak = 0.0

    def restart(self) -> None:
        """Nothing has been seen."""
        self._recent.clear()
        self.peak = 0.0

    def take(self, sample: float) -> bool:
        """A sample; whether it has dropped."""
        self._recent.append(sample)
        self.peak = max(self._recent)
        drop = self.peak - sample
        return drop > self._share * self.peak and drop > self._least


class Slip:
    """The force of a pierced membrane while it goes. over: it is gone, or another membrane carries the tip.

    most: samples until it is gone. least: rise from the lowest sample that noise does not make.
    """

    def __init__(self, most: int, least: float) -> None:
        self._most, self._least = most, least
        self._lowest, self._taken = inf, 0
        self.over = False

    def take(self, sample: float) -> bool:
        """A sample; whether it is over by this one."""
        self._lowest, self._taken = min(self._lowest, sample), self._taken + 1
        ends = not self.over and (self._taken >= self._most or sample - self._lowest > self._least)
        self.over = self.over or ends
        return ends


class Slope:
    """Least-squares slope of the last samples over their places. window: samples, 3 or more."""

    def __init__(self, window: int) -> None:
        self._points: deque[tuple[float, float]] = deque(maxlen=window)

    def restart(self) -> None:
        """Nothing has been seen."""
        self._points.clear()

    def take(self, place: float, value: float) -> None:
        """One more."""
        self._points.append((place, value))

    @property
    def value(self) -> float:
        """Unit of the samples over that of the places; 0.0 until it can be told."""
        n = len(self._points)
        if n < 3:
            return 0.0
        mean_place = sum(place for place, _ in self._points) / n
        mean = sum(value for _, value in self._points) / n
        spread = sum((place - mean_place) ** 2 for place, _ in self._points)
        if spread <= 0.0:
            return 0.0
        return sum((place - mean_place) * (value - mean) for place, value in self._points) / spread
