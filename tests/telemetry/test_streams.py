"""A stream through a bad network keeps every limit, and rests behind its last knot (`make bench ARGS=streams`)."""

import random

import pytest

from hil.rig.file import load_rig
from tests.benchmarks.streams import MOST_RATIO, NETWORKS, REST_S, Network, arrivals, bars_missed, path, through
from tests.support.paths import RIGS

MS = 1_000_000


def test_a_network_loses_delays_and_reorders_as_it_says_and_the_last_knot_always_comes() -> None:
    clean = list(arrivals(Network("clean"), 10 * MS, random.Random(1)))
    assert [sent for _, sent, _, _ in clean] == [10 * MS * k for k in range(101)]
    assert {arrived - sent for arrived, sent, _, _ in clean} == {5 * MS}
    assert clean[50][2:] == path(0.5)
    assert path(0.5) == pytest.approx((1e-3, 0.0), abs=1e-15)
    lossy = list(arrivals(Network("loss", loss=0.5), 10 * MS, random.Random(1)))
    assert 30 < len(lossy) < 70
    assert lossy[-1][1:] == (1000 * MS, 0.0, 0.0)
    silent = list(arrivals(Network("gaps", gap_s=0.1), 10 * MS, random.Random(1)))
    assert not [sent for _, sent, _, _ in silent if 300 * MS < sent < 400 * MS]
    swapped = [arrived for arrived, *_ in arrivals(Network("order", swapped=0.3), 10 * MS, random.Random(1))]
    assert swapped != sorted(swapped)


@pytest.mark.long
@pytest.mark.parametrize("network", [NETWORKS[0], NETWORKS[-1]], ids=lambda network: network.name)
def test_a_stream_keeps_its_limits_and_rests_whatever_the_network_does(network: Network) -> None:
    one = through(load_rig(RIGS / "microscope-ideal.toml"), RIGS, network, 100.0, 1)
    assert (one.sent, one.broken) == (101, "")
    assert one.rests <= REST_S
    assert bars_missed(network, one, one.error) == ""
    assert bars_missed(network, one._replace(rests=0.05, broken="speed"), one.error) == "speed, rest"
    if network.name == "clean":
        assert (one.arrived, one.late, one.disordered, one.limited) == (101, 0, 0, 0)
        assert one.error < 3e-7
        assert bars_missed(network, one, 0.99 * one.error / MOST_RATIO) == "error"
    else:
        assert one.arrived < 90
        assert one.worst > 1e-5
