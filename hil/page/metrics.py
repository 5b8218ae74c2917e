"""Figures of rigs for a monitoring system, in OpenMetrics 1.0 (openmetrics.io): `hil page --metrics` answers /metrics.

prometheus_client writes the text, as escapes and units are its business. It asks the sidecars that the page hears
already; nothing here reaches a control process. A rig that is not heard shows hil_up 0, and no figure that is old.
"""

from collections.abc import Iterator, Mapping
from typing import Final

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.openmetrics.exposition import CONTENT_TYPE_LATEST, generate_latest
from prometheus_client.registry import Collector, CollectorRegistry

from hil.page.hub import Heard

_QUANTILES: Final = ("0.5", "0.99", "1")
_FRAMES: Final = ("sent", "received", "samples_lost", "rejected", "refused")


class _Rigs(Collector):
    def __init__(self, rigs: Mapping[str, Heard]) -> None:
        self._rigs = rigs

    def collect(self) -> Iterator[Metric]:
        """One family after the other, each of all rigs."""
        up = GaugeMetricFamily("hil_up", "1 where the rig's sidecar is heard", labels=["rig"])
        for rig, heard in self._rigs.items():
            up.add_metric([rig], 1.0 if heard.status else 0.0)
        yield up
        heard_rigs = {rig: heard for rig, heard in self._rigs.items() if heard.status}
        yield from _states(heard_rigs)
        yield from _figures(heard_rigs)
        yield from _counters(heard_rigs)


def _states(rigs: Mapping[str, Heard]) -> Iterator[Metric]:
    for name, key, text in (
        ("hil_control_alive", "alive", "1 while the control process writes ticks"),
        ("hil_recording", "recording", "1 while the sidecar records"),
    ):
        family = GaugeMetricFamily(name, text, labels=["rig"])
        for rig, heard in rigs.items():
            family.add_metric([rig], float(bool(heard.status[key])))
        yield family
    latched = GaugeMetricFamily("hil_fault_latched", "1 for the fault that is latched", labels=["rig", "fault", "axis"])
    for rig, heard in rigs.items():
        if heard.status["latched"] is not None:
            latched.add_metric([rig, heard.status["latched"]["name"], heard.status["latched"]["axis"]], 1.0)
    yield latched


def _figures(rigs: Mapping[str, Heard]) -> Iterator[Metric]:
    for kind, unit in (("linear", "meters"), ("rotary", "radians")):
        family = GaugeMetricFamily(
            f"hil_following_error_max_{unit}", "greatest since the status before", labels=["rig", "axis"], unit=unit
        )
        for rig, heard in rigs.items():
            for (axis, found), value in zip(heard.axes.items(), heard.status["max_error"], strict=False):
                if found == kind and value is not None:
                    family.add_metric([rig, axis], value)
        yield family
    late = GaugeMetricFamily(
        "hil_tick_lateness_seconds", "of the control process, since the status before", labels=["rig", "quantile"],
        unit="seconds",
    )  # fmt: skip
    for rig, heard in rigs.items():
        for quantile, value in zip(_QUANTILES, heard.status["late"], strict=True):
            if value is not None:
                late.add_metric([rig, quantile], value)
    yield late


def _counters(rigs: Mapping[str, Heard]) -> Iterator[Metric]:
    missed = CounterMetricFamily("hil_ticks_missed", "by its own lateness, or by the host's", labels=["rig", "by"])
    frames = CounterMetricFamily("hil_frames", "of the bus, as the control process has them", labels=["rig", "kind"])
    dropped = CounterMetricFamily("hil_telemetry_dropped", "ticks that the sidecar came too late for", labels=["rig"])
    for rig, heard in rigs.items():
        for by, value in zip(("own", "host"), heard.status["missed"], strict=True):
            missed.add_metric([rig, by], value)
        for kind, value in zip(_FRAMES, heard.status["frames"], strict=True):
            frames.add_metric([rig, kind], value)
        dropped.add_metric([rig], heard.status["dropped"])
    yield missed
    yield frames
    yield dropped


def exposition(rigs: Mapping[str, Heard]) -> tuple[bytes, str]:
    """The answer to a scrape, and its media type. rigs: by name."""
    registry = CollectorRegistry(auto_describe=False)
    registry.register(_Rigs(rigs))
    return generate_latest(registry), CONTENT_TYPE_LATEST  # type: ignore[no-untyped-call]
