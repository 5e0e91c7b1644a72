"""The page's lamps in a browser, in every one of fifteen states: none is green by what is not true now."""

import asyncio
import json
from pathlib import Path
from typing import Any, Final

import pytest

from companion.app.page.look import Text
from tests.browser import DESK, PHONE, Tab, browser, program
from tests.unit.app.page.test_server import ServedPage, served

pytestmark = pytest.mark.skipif(program() is None, reason="no Chromium here; Debian: apt install chromium")

NAMES: Final = ("camera", "IMU", "magnetometer", "GPS", "ultrasonic")
MACHINE: Final = {"cpu_percent": 20.0, "memory_mb": 100.0, "temperature_deg_c": 50.0, "disk_free_mb": 5000.0}
LAMPS: Final = (
    "Object.fromEntries([...document.querySelectorAll('#lights li')].map((li) => "
    "[li.querySelector('div').firstChild.textContent,"
    " [li.className, li.querySelector('small').textContent]]))"
)


def entry(name: str, **changes: Any) -> dict[str, Any]:
    use = {"used": 100, "refused": 0, "unused": False, "reason": ""}
    return {"name": name, "rate_hz": 30.0, "age_s": 0.05, "silent": False, **use, **changes}


def state(inputs: dict[str, dict[str, Any] | None] | None = None, **changes: Any) -> dict[str, Any]:
    """One that is well in every respect, but for what is changed; None: an input that never came."""
    changed = inputs or {}
    listed = [entry(name, **(changed.get(name) or {})) for name in NAMES if changed.get(name, {}) is not None]
    well: dict[str, Any] = {
        "kind": "state", "phase": "standby", "order": None, "up_s": 100.0, "autopilot": "px4",
        "mode": "HOLD", "armed": True, "battery_percent": 80.0, "inputs": listed, "aligned": True,
        "estimate_problem": None, "attitude_std_deg": 0.5, "velocity_std_m_s": 0.1, "position_std_m": 1.0,
        "pad_seen_s": 0.1, "latency": {}, "late_cycles_percent": 0.0, "machine": MACHINE,
        "recording": None, "events": [{"time_s": 90.0, "severity": "info", "text": "standby"}],
        "problems": [], "phases": [[0.0, "standby"]], "viewers": 1,
    }  # fmt: skip
    return {**well, **changes}


GOOD: Final = dict.fromkeys(("autopilot", *NAMES, "estimate", "pad"), "good")
UNCERTAIN: Final = "velocity uncertain: 11.0 m/s, limit 1"
CASES: Final[dict[str, tuple[dict[str, Any], dict[str, str]]]] = {
    "standing by": (state(), GOOD),
    "starting": (
        state(
            dict.fromkeys(NAMES, None),
            autopilot=None, aligned=False, pad_seen_s=None, estimate_problem="starting",
            attitude_std_deg=None, velocity_std_m_s=None,
        ),
        {**dict.fromkeys(GOOD, "silent"), "ultrasonic": "absent", "pad": "absent"},
    ),
    # no sensor but the camera: nothing is said of the others
    "vision only": (
        state(
            {name: None for name in NAMES if name != "camera"},
            vision_only=True, aligned=False, attitude_std_deg=None, velocity_std_m_s=None,
        ),
        dict.fromkeys(("autopilot", "camera", "pad"), "good"),
    ),
    "estimate bad": (
        state(velocity_std_m_s=11.02, estimate_problem=UNCERTAIN, problems=[UNCERTAIN]),
        {**GOOD, "estimate": "silent"},
    ),
    "GPS silent": (state({"GPS": {"silent": True, "age_s": 7.0}}), {**GOOD, "GPS": "silent"}),
    "GPS refused": (
        state({"GPS": {"unused": True, "refused": 40, "reason": "stamped 0.4 s ahead of the IMU"}}),
        {**GOOD, "GPS": "warning"},
    ),
    "no autopilot": (state(autopilot=None), {**GOOD, "autopilot": "silent"}),
    "camera silent": (
        state({"camera": {"silent": True, "age_s": 3.0}}, pad_seen_s=3.1),
        {**GOOD, "camera": "silent", "pad": "warning"},
    ),
    "high up": (
        state({"ultrasonic": {"age_s": 20.0, "rate_hz": 0.0}}, pad_seen_s=None, phase="search"),
        {**GOOD, "ultrasonic": "absent", "pad": "absent"},
    ),
    "descending": (state(phase="descend", order="land by RC"), GOOD),
    "pad lost": (state(phase="search", pad_seen_s=6.0), {**GOOD, "pad": "warning"}),
    # so near that no marker is whole: the pad is not in sight any more
    "contact": (state(phase="touchdown", order="land by RC", pad_seen_s=1.4), {**GOOD, "pad": "warning"}),
    "landed": (state(phase="landed", armed=False), GOOD),
}  # fmt: skip


async def lamps(tab: Tab) -> dict[str, tuple[str, str]]:
    return {name: (kind, words) for name, (kind, words) in (await tab.evaluate(LAMPS)).items()}


async def opened(on: ServedPage, tab: Tab) -> None:
    await tab.resize(PHONE)
    await tab.open(f"http://{on.address}/")
    await tab.wait_for("document.querySelectorAll('#lights li').length === 8")
    async with asyncio.timeout(20.0):
        while not on.said:  # noqa: ASYNC110 - it is another process
            await asyncio.sleep(0.05)


async def test_the_lamps_are_true_in_every_state(tmp_path: Path) -> None:
    async with served() as on, browser(tmp_path) as tab:
        # nothing is known yet
        await opened(on, tab)
        assert {kind for kind, _ in (await lamps(tab)).values()} == {"unknown"}
        # all that are known
        for name, (shown, expected) in CASES.items():
            on.server.text(Text("state", json.dumps({**shown, "up_s": shown["up_s"] + 0.001 * len(name)})))
            async with asyncio.timeout(10.0):
                while {n: kind for n, (kind, _) in (await lamps(tab)).items()} != expected:
                    on.server.text(Text("state", json.dumps(shown)))
                    await asyncio.sleep(0.1)
            header = await tab.evaluate("document.getElementById('vehicle').textContent")
            assert ("battery" in header) == (shown["autopilot"] is not None)  # nobody else knows it
        on.server.text(Text("state", json.dumps(state())))
        await tab.wait_for("document.getElementById('vehicle').textContent.includes('ARMED')")
        # nothing comes any more: nothing stays green, and ages go on
        await tab.wait_for("!document.querySelector('#lights .good')")
        assert {kind for kind, _ in (await lamps(tab)).values()} == {"unknown"}
        vehicle = "document.getElementById('vehicle').textContent"
        assert "ARMED" not in await tab.evaluate(vehicle)
        assert "unknown for" in await tab.evaluate(vehicle)
        before = await tab.evaluate("document.querySelector('#events time').textContent")
        await tab.wait_for(f"document.querySelector('#events time').textContent !== '{before}'")
        assert "NO DATA" in await tab.evaluate("document.getElementById('alarm').textContent")
        assert tab.console == []


@pytest.mark.parametrize("size", [PHONE, DESK])
async def test_the_inputs_are_on_the_first_screen(tmp_path: Path, size: tuple[int, int]) -> None:
    async with served(allow_commands=True) as on, browser(tmp_path) as tab:
        await opened(on, tab)
        await tab.resize(size)
        on.server.text(Text("state", json.dumps(state(problems=[UNCERTAIN]))))
        await tab.wait_for("document.querySelector('#lights .good')")
        bottom = await tab.evaluate("document.getElementById('lights').getBoundingClientRect().bottom")
        orders = await tab.evaluate("document.getElementById('orders').getBoundingClientRect().top")
        assert bottom <= (orders if size == PHONE else size[1])


# what a phone does, counted in place of done
COUNTED: Final = """
  window.done = {tones: 0, shakes: 0, locks: 0};
  const made = AudioContext.prototype.createOscillator;
  AudioContext.prototype.createOscillator = function () { done.tones += 1; return made.call(this); };
  navigator.vibrate = () => { done.shakes += 1; };
  Object.defineProperty(navigator, "wakeLock", {value: {request: async () => { done.locks += 1;
    return {release: async () => {}}; }}});
"""


async def test_who_wants_it_hears_and_feels_a_problem_and_the_screen_stays_on(tmp_path: Path) -> None:
    async with served() as on, browser(tmp_path) as tab:
        await opened(on, tab)
        await tab.evaluate(COUNTED)
        on.server.text(Text("state", json.dumps(state())))
        await tab.wait_for("document.querySelector('#lights .good')")
        bad = state(problems=[UNCERTAIN])
        on.server.text(Text("state", json.dumps({**bad, "up_s": 100.5})))
        await tab.wait_for("!document.getElementById('alarm').hidden")
        assert await tab.evaluate("done.tones + done.locks") == 0  # nobody has asked for it
        await tab.touch("document.getElementById('watch')")
        await tab.wait_for("done.locks === 1")
        assert "screen stays on" in await tab.evaluate("document.getElementById('watching').textContent")
        on.server.text(Text("state", json.dumps({**state(), "up_s": 101.0})))
        await tab.wait_for("document.getElementById('alarm').hidden")
        before = await tab.evaluate("done")
        on.server.text(Text("state", json.dumps({**bad, "up_s": 101.5})))
        await tab.wait_for("!document.getElementById('alarm').hidden")
        after = await tab.evaluate("done")
        assert after["tones"] > before["tones"]
        assert after["shakes"] > before["shakes"]
        assert tab.console == []
