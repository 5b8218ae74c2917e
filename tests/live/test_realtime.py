"""What the kernel grants is read back, and a refusal is named with its remedy."""

import gc
import json
import os
import subprocess
import sys

import pytest

from hil.live import realtime
from hil.live.realtime import Grant, RealtimeVerdict
from hil.rig.schema import TimingConfig

# `claim` changes the whole process (priority, memory, collector), so the tests watch it from outside.
PROBE = """
import json, gc, os, sys
from hil.rig.schema import TimingConfig
from hil.live.realtime import claim
{before}
held = claim(TimingConfig(**json.loads(sys.argv[1])))
fd = held.latency_fd
pid = os.fork()
if pid == 0:
    os._exit(os.sched_getscheduler(0))
child_policy = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
print(json.dumps({{
    "grants": {{g.name: [g.asked, g.granted, g.detail, g.remedy] for g in held.verdict.grants}},
    "ok": held.verdict.ok, "text": held.verdict.text(),
    "policy": os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK, "priority": os.sched_getparam(0).sched_priority,
    "affinity": sorted(os.sched_getaffinity(0)), "collector": gc.isenabled(), "child_policy": child_policy,
    "locked": [l for l in open("/proc/self/status") if l.startswith("VmLck")][0].split()[1],
    "latency_open": fd >= 0 and os.readlink(f"/proc/self/fd/{{fd}}"),
}}))
"""
# Without its capabilities and limits root is treated like anybody else.
POWERLESS = """
import resource
resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
resource.setrlimit(resource.RLIMIT_MEMLOCK, (65536, 65536))
if os.getuid() == 0:
    os.setgroups([]); os.setgid(65534); os.setuid(65534)
"""


def probe(before="", **timing):
    command = [sys.executable, "-c", PROBE.format(before=before), json.dumps(timing)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def may_use_fifo():
    policy, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except PermissionError:
        return False
    os.sched_setscheduler(0, policy, parameter)
    return True


def test_what_is_granted_is_what_the_kernel_reads_back():
    seen = probe(priority=42)
    grants = seen["grants"]
    assert grants["priority"][1] == (seen["policy"] == os.SCHED_FIFO and seen["priority"] == 42)
    assert grants["priority"][1] == may_use_fifo()
    assert grants["core"][1]
    assert seen["affinity"] == [max(os.sched_getaffinity(0))]
    assert grants["memory"][1] == (int(seen["locked"]) > 0)
    assert grants["dma_latency"][1] == (seen["latency_open"] == realtime.DMA_LATENCY)
    assert grants["collector"][1]
    assert not seen["collector"]
    assert seen["ok"] == all(granted for _, granted, _, _ in grants.values())


# Nothing is mapped at 64 kB. Asked for once, it is a mapping that was gone before it could be locked.
GONE = """
from hil.live import realtime
mappings, left = realtime._mappings, {times}
def some_gone():
    global left
    yield from mappings()
    if left:
        left -= 1
        yield 0x10000, 0x1000
realtime._mappings = some_gone
"""


@pytest.mark.long
@pytest.mark.skipif(os.geteuid() != 0, reason="others may not lock memory at all")
def test_memory_that_was_given_back_before_it_could_be_locked_is_no_refusal():
    """To read the list of mappings takes memory: what holds it is in the list, and gone a moment later."""
    locks = probe()["grants"]["memory"][1]
    assert probe(GONE.format(times=1))["grants"]["memory"][1] == locks
    refused = probe(GONE.format(times=2))["grants"]["memory"]
    assert not refused[1]
    assert "mlock of 1 mappings: Cannot allocate memory" in refused[2] or not locks


def test_a_child_of_the_loop_process_is_not_real_time():
    assert probe()["child_policy"] == os.SCHED_OTHER


def test_a_refusal_names_what_was_refused_and_what_to_do():
    seen = probe(before=POWERLESS)
    for name in ("priority", "memory", "dma_latency"):
        asked, granted, detail, remedy = seen["grants"][name]
        assert asked
        assert not granted, name
        assert detail
        assert remedy
    assert not seen["ok"]
    assert seen["text"].startswith("real time degraded: ")
    assert "CAP_SYS_NICE" in seen["text"]


def test_asking_for_nothing_is_granted_and_leaves_the_scheduler_alone():
    seen = probe(before=POWERLESS, realtime=False)
    assert seen["ok"]
    assert seen["policy"] == os.sched_getscheduler(0)  # whatever it was: tests may run in the idle class
    assert seen["locked"] == "0"
    assert seen["affinity"] == sorted(os.sched_getaffinity(0))


def test_a_core_that_does_not_exist_is_a_refusal():
    asked, granted, detail, remedy = probe(cpu=1023)["grants"]["core"]
    assert (asked, granted) == (True, False)
    assert "1023" in detail
    assert "timing.cpu" in remedy


def test_one_refusal_spoils_the_verdict_and_what_was_not_asked_does_not():
    fine = Grant("core", True, True, "core 1")
    unasked = Grant("memory", False, False, "not asked for")
    refused = Grant("priority", True, False, "SCHED_FIFO 80: denied", "run as root")
    assert RealtimeVerdict((fine, unasked)).ok
    verdict = RealtimeVerdict((fine, unasked, refused))
    assert not verdict.ok
    assert verdict.refused == (refused,)
    assert verdict.text() == "real time degraded: priority refused (SCHED_FIFO 80: denied; run as root)"


def test_collections_that_happen_in_spite_of_everything_are_counted():
    held = realtime.Claim(RealtimeVerdict(()))
    before = list(gc.callbacks)
    try:
        assert realtime._still_collector(held)[0]
        gc.collect()
        gc.collect()
    finally:
        gc.enable()
        gc.unfreeze()
        gc.callbacks[:] = before
    assert held.collector_runs == [2]


@pytest.mark.parametrize("priority", [0, 100])
def test_a_priority_the_kernel_does_not_have_is_refused_by_the_rig_schema(priority):
    with pytest.raises(ValueError, match="priority"):
        TimingConfig(priority=priority)
