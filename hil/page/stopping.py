"""What the page's buttons do: E-STOP as `hil estop` does it, the others as `hil command` does."""

import asyncio
import time
from typing import Any, Final

from hil.cycle.tick import CommandKind
from hil.live.runtime_paths import nearest
from hil.live.stop_page import Page, Status, live_pages
from hil.operate.estop import HUNG, LATCH_S, NOBODY, told
from hil.telemetry.command_client import NoGatewayError, local_client

_POLL_S: Final = 0.001


async def emergency_stop(rig: str) -> dict[str, Any]:
    """Press stop on every control process of that name, then wait until each has latched it, half a second at most.

    No sidecar, no thread and no disk is needed. accepted: all are in ESTOP. said: what became of it, in words.
    """
    pages = live_pages(rig)
    pressed = [page.press() for page in pages]  # all of them before the first answer is waited for
    if not pages:
        return {"accepted": False, "status": NOBODY, "said": f"no control process of the name {rig!a} runs here"}
    try:
        found = [told(rig, at, await _latched(page, at)) for page, at in zip(pages, pressed, strict=True)]
    finally:
        for page in pages:
            page.close()
    worst = max(status for status, _ in found)
    return {"accepted": worst == 0, "status": worst, "said": "; ".join(text for _, text in found)}


async def _latched(page: Page, pressed_ns: int) -> Status:
    until = time.monotonic() + LATCH_S
    while (status := page.status()).latched_at < pressed_ns and status.alive and time.monotonic() < until:
        await asyncio.sleep(_POLL_S)
    return status


def ask(rig: str, kind: CommandKind) -> dict[str, Any]:
    """An operator's command through the sidecar, with the control process' verdict; waits up to a second."""
    try:
        with nearest(rig, local_client, NoGatewayError) as client:
            verdict = client.command(kind)
    except NoGatewayError as error:
        return {"accepted": False, "status": HUNG, "said": str(error)}
    said = "accepted" if verdict.accepted else verdict.reason
    return {"accepted": verdict.accepted, "status": int(not verdict.accepted), "said": f"{said}; state {verdict.state}"}
