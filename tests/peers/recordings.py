"""Recordings: mcap's own reader and decoder against ours, on a lockstep run and on a live one."""

import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

import hil
from hil.telemetry.recording import Recording
from tests.peers.table import DIFFERS, NOT_RUN, PASSED, Row
from tests.support.paths import RIGS, ROOT

PEER = "mcap"
LIVE_S = 60.0  # at most, for a run of two seconds


def rows(work: Path, *, few: bool) -> Iterator[Row]:
    """Rows of a lockstep recording; of a live one, in the long run."""
    hil.simulate(RIGS / "paper.toml", 2.0, record=work / "lockstep.mcap")
    yield from _of_recording("lockstep", work / "lockstep.mcap")
    yield from _of_recording("of version 0.1.0", ROOT / "tests" / "reference" / "recording-0.1.0.mcap")
    if not few:
        yield from _live(work)


def _live(work: Path) -> Iterator[Row]:
    words = [
        sys.executable,
        "-m",
        "hil",
        "demo",
        str(RIGS / "paper.toml"),
        "--live",
        "--seconds",
        "2",
        "--out",
        str(work / "live"),
    ]
    try:
        done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=LIVE_S, check=False)
    except subprocess.TimeoutExpired:
        yield Row(PEER, "live", NOT_RUN, f"hil demo was not done after {LIVE_S:g} s")
        return
    found = sorted((work / "live").rglob("*.mcap"))
    if not found:
        yield Row(PEER, "live", NOT_RUN, f"hil demo ended with {done.returncode}: {done.stderr.strip()[-200:]}")
        return
    yield from _of_recording("live", found[0])


def _of_recording(name: str, path: Path) -> Iterator[Row]:
    """Checksums of the chunks, the counts of messages in the summary, every message decoded, and as ours has them."""
    try:
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
            summary = reader.get_summary()
            decoded = [
                (channel.topic, message.log_time, message.data) for _, channel, message in reader.iter_messages()
            ]
            kinds = Counter(channel.topic for _, channel, _, _ in reader.iter_decoded_messages())
    except McapError as error:
        yield Row(PEER, f"{name}: read", DIFFERS, f"they: {type(error).__name__}: {error}")
        return
    yield Row(PEER, f"{name}: read", PASSED, f"{len(decoded)} messages of {len(kinds)} topics")
    stated = summary.statistics.message_count if summary and summary.statistics else None
    counted = sum(kinds.values())
    same = stated == len(decoded) == counted
    yield Row(
        PEER, f"{name}: counts", PASSED if same else DIFFERS, f"stated {stated}, read {len(decoded)}, decoded {counted}"
    )
    ours = Counter((item.topic, item.data) for item in Recording(path))
    theirs = Counter((topic, data) for topic, _, data in decoded)
    found = "" if ours == theirs else f"{len(theirs - ours)} only theirs, {len(ours - theirs)} only ours"
    yield Row(PEER, f"{name}: messages", DIFFERS if found else PASSED, found)
