"""The checklist on made-up Raspberry Pis: only what was agreed to is done, and it is done once."""

import io
import re
from dataclasses import replace
from pathlib import Path

import pytest

from companion.base.errors import ConfigError
from companion.cli import COMMANDS
from companion.config import CONFIG_FOLDER, CompanionConfig, validate
from companion.tools.setup.boot_files import has_overlay, parameter, with_lines, without_serial_console
from companion.tools.setup.job import Answers, go_through
from companion.tools.setup.machine import BEFORE, MODELS, Machine
from companion.tools.setup.steps import STEPS, Step, StepState, time_synchronisation

CONFIG_TXT = "dtparam=audio=on\n[cm4]\notg_mode=1\n[all]\n"
CMDLINE = "console=serial0,115200 console=tty1 root=PARTUUID=1-02 rootwait\n"
GROUP = "dialout:x:20:\ni2c:x:994:\nvideo:x:44:pilot\ncompanion:x:993:\n"
TIME_OFF = "NTP=no\nCanNTP=yes\n"
BOARDS = CompanionConfig()


class Programs:
    """Programs that are told, not run; time synchronisation is as `timedatectl set-ntp` left it."""

    def __init__(self, machine_root: Path, *, fails: str = "") -> None:
        self.ran: list[tuple[str, ...]] = []
        self.root, self.fails = machine_root, fails
        self.time_on = False

    def __call__(self, words: tuple[str, ...]) -> tuple[int, str]:
        if words[:2] == ("systemctl", "is-active"):
            return 3, ""
        if words[:2] == ("timedatectl", "show"):
            return 0, TIME_OFF.replace("NTP=no", "NTP=yes") if self.time_on else TIME_OFF
        self.ran.append(words)
        if words[0] == self.fails:
            return 1, "one line\nno network\n"
        if words[0] == "timedatectl":
            self.time_on = True
        if words[0] == "usermod":
            group = self.root / "etc/group"
            lines = group.read_text().splitlines()
            names = words[3].split(",")
            group.write_text(
                "\n".join(line + f",{words[4]}" if line.split(":")[0] in names else line for line in lines)
                + "\n"
            )
        return 0, ""


def raspberry_pi(
    root: Path, model: str, *, fails: str = "", modules: frozenset[str] = frozenset()
) -> Machine:
    for name, text in {
        "proc/device-tree/model": f"{model} Rev 1.4\0",
        "boot/firmware/config.txt": CONFIG_TXT,
        "boot/firmware/cmdline.txt": CMDLINE,
        "etc/group": GROUP,
    }.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    return Machine(root, Programs(root, fails=fails), modules.__contains__, user="pilot")


def programs(machine: Machine) -> list[tuple[str, ...]]:
    assert isinstance(machine.run, Programs)
    return machine.run.ran


def steps(machine: Machine, config: CompanionConfig = BOARDS) -> dict[str, Step]:
    return {look.__name__: look(machine, config) for look in STEPS}


def tree(root: Path) -> dict[str, str]:
    return {str(path.relative_to(root)): path.read_text() for path in root.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    ("model", "gps", "autopilot", "rangefinder"),
    [
        ("Raspberry Pi 4 Model B", "dtoverlay=disable-bt", "dtoverlay=uart3", "dtoverlay=uart5"),
        ("Raspberry Pi Compute Module 4", "dtoverlay=disable-bt", "dtoverlay=uart3", "dtoverlay=uart5"),
        ("Raspberry Pi 5 Model B", "dtparam=uart0=on", "dtoverlay=uart2-pi5", "dtoverlay=uart4-pi5"),
        ("Raspberry Pi 500", "dtparam=uart0=on", "dtoverlay=uart2-pi5", "dtoverlay=uart4-pi5"),
    ],
)
def test_the_uarts_are_the_models_and_those_of_the_wiring_page(
    model: str, gps: str, autopilot: str, rangefinder: str, tmp_path: Path
) -> None:
    found = steps(raspberry_pi(tmp_path, model))
    page = (CONFIG_FOLDER.parent / "docs" / "how-to" / "wiring.md").read_text()
    lines = {"gps_uart": gps, "autopilot_uart": autopilot, "rangefinder_uart": rangefinder}
    for name, line in lines.items():
        [change] = found[name].changes
        assert getattr(change, "added", None) == (line,)
        assert f"`{line}`" in page


def test_a_pi_with_one_uart_says_what_else_to_do(tmp_path: Path) -> None:
    found = steps(raspberry_pi(tmp_path, "Raspberry Pi Zero 2 W"))
    assert found["gps_uart"].state is StepState.TO_DO
    assert found["autopilot_uart"].state is StepState.LEFT_OUT
    assert "USB" in found["autopilot_uart"].detail


def test_a_computer_that_is_no_pi_is_left_as_it_is(tmp_path: Path) -> None:
    machine = Machine(tmp_path, Programs(tmp_path), frozenset().__contains__)
    changes = [change for step in steps(machine).values() for change in step.changes]
    assert changes == [("timedatectl", "set-ntp", "true")]
    left_out = [step.detail for name, step in steps(machine).items() if name not in {"groups", "packages"}]
    assert set(left_out[:-1]) == {"not a Raspberry Pi"}
    assert "usermod -aG companion,dialout,i2c,spi,video,gpio USER" in steps(machine)["groups"].detail
    other = raspberry_pi(tmp_path, "Raspberry Pi 9")
    assert steps(other)["serial_console"].detail == "not known here: Raspberry Pi 9 Rev 1.4"


def test_a_plan_changes_nothing_and_shows_every_change(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    machine = raspberry_pi(tmp_path, "Raspberry Pi 4 Model B")
    before = tree(tmp_path)
    assert go_through(machine, BOARDS, Answers.NONE)
    assert (tree(tmp_path), programs(machine)) == (before, [])
    told = capsys.readouterr().out
    for line in ("+ dtoverlay=uart5", "- console=serial0,115200", "+ i2c-dev", "run: modprobe i2c-dev"):
        assert line in told
    assert "+ dtoverlay=uart3" in told
    assert told.endswith("\nnothing changed, 6 steps that the settings need left open\n")
    assert "the settings do not need it" in told  # the autopilot is at a UDP port in the shipped settings


def test_what_the_settings_need_is_done_once_and_found_done(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    machine = raspberry_pi(tmp_path, "Raspberry Pi 4 Model B")
    assert go_through(machine, BOARDS, Answers.SUGGESTED)
    told = capsys.readouterr().out
    config = machine.read("/boot/firmware/config.txt") or ""
    assert config.startswith(CONFIG_TXT)
    for line in (
        "dtoverlay=disable-bt",
        "dtoverlay=uart5",
        "dtparam=i2c_arm=on",
        "dtparam=i2c_arm_baudrate=400000",
    ):
        assert f"\n{line}\n" in config
    for line in ("dtoverlay=uart3", "dtparam=spi=on"):
        assert line not in config
    assert machine.read("/boot/firmware/cmdline.txt") == "console=tty1 root=PARTUUID=1-02 rootwait\n"
    assert machine.read("/boot/firmware/config.txt" + BEFORE) == CONFIG_TXT
    assert programs(machine) == [
        ("modprobe", "i2c-dev"),
        ("usermod", "--append", "--groups", "companion,dialout,i2c", "pilot"),
        ("timedatectl", "set-ntp", "true"),
    ]
    assert "changed /boot/firmware/config.txt" in told
    assert "sudo reboot" in told

    after = tree(tmp_path)
    assert {name: step.state for name, step in steps(machine).items() if step.needed and step.changes} == {}
    assert go_through(machine, BOARDS, Answers.SUGGESTED)
    assert tree(tmp_path) == after
    assert len(programs(machine)) == 3


def test_only_what_is_agreed_to_is_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    machine = raspberry_pi(tmp_path, "Raspberry Pi 5 Model B")
    asked = list[bool]()

    def confirm(_words: str, *, default: bool) -> bool:
        asked.append(default)
        return len(asked) == 2  # the autopilot's UART alone

    monkeypatch.setattr("typer.confirm", confirm)
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    assert go_through(machine, BOARDS, Answers.ASKED)
    assert asked[:2] == [True, False]  # as the settings need it
    added = (machine.read("/boot/firmware/config.txt") or "").removeprefix(CONFIG_TXT)
    assert re.findall(r"^[^#\n].*$", added, re.MULTILINE) == ["dtoverlay=uart2-pi5"]
    assert programs(machine) == []


def test_with_nobody_to_ask_it_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO())
    with pytest.raises(ConfigError, match="no terminal to ask at; expected --plan, --yes, or a terminal"):
        go_through(raspberry_pi(tmp_path, "Raspberry Pi 5"), BOARDS, Answers.ASKED)


def test_settings_for_spi_pins_and_the_pis_own_camera_need_their_packages(tmp_path: Path) -> None:
    config = validate(
        CompanionConfig,
        {
            "sense": {
                "imu": {"bus": "spi:0.0"},
                "range": {"kind": "gpio"},
                "vision": {"source": "picamera2:0"},
            }
        },
        "test",
    )
    machine = raspberry_pi(tmp_path, "Raspberry Pi 4", modules=frozenset({"gpiozero"}))
    found = steps(machine, config)
    install = found["packages"].changes[-1]
    assert isinstance(install, tuple)
    assert install[-3:] == ("python3-picamera2", "python3-spidev", "python3-lgpio")
    assert found["spi"].needed
    assert not found["i2c"].needed
    assert not found["rangefinder_uart"].needed
    there = replace(machine, has_module=lambda _name: True)
    assert steps(there, config)["packages"].state is StepState.DONE


def test_a_change_that_fails_is_told_and_the_rest_is_done(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    machine = raspberry_pi(tmp_path, "Raspberry Pi 4 Model B", fails="usermod")
    assert not go_through(machine, BOARDS, Answers.SUGGESTED)
    assert (
        "failed: usermod --append --groups companion,dialout,i2c pilot: no network" in capsys.readouterr().out
    )
    assert programs(machine)[-1] == ("timedatectl", "set-ntp", "true")


@pytest.mark.parametrize(("unit", "done"), [("chrony", True), ("", False)])
def test_another_program_that_sets_the_clock_counts(unit: str, done: bool, tmp_path: Path) -> None:
    def run(words: tuple[str, ...]) -> tuple[int, str]:
        return (0, "") if unit and words[-1] == unit else (3, TIME_OFF if words[0] == "timedatectl" else "")

    assert (time_synchronisation(Machine(tmp_path, run), BOARDS).state is StepState.DONE) is done


def test_it_is_a_command_and_the_models_differ() -> None:
    assert "setup" in COMMANDS
    names = [name for group in MODELS for name in group]
    assert len(names) == len(set(names))


# ---------------- config.txt and cmdline.txt: what counts for a model is found, and what is added counts

PI4, PI5 = frozenset({"pi4", "cm4"}), frozenset({"pi5", "cm5"})
# as Raspberry Pi OS ships it, shortened
SHIPPED = """\
# For more options and information see
#dtparam=i2c_arm=on
#dtparam=spi=on
dtparam=audio=on
camera_auto_detect=1
[cm4]
otg_mode=1
dtoverlay=dwc2,dr_mode=host
[cm5]
dtoverlay=dwc2,dr_mode=host
[all]
"""


@pytest.mark.parametrize(
    ("text", "sections", "found"),
    [
        ("dtoverlay=uart3\n", PI4, True),
        ("dtoverlay=uart3,ctsrts\n", PI4, True),
        ("  dtoverlay=uart3  # the autopilot\n", PI4, True),
        ("#dtoverlay=uart3\n", PI4, False),
        ("dtoverlay=uart30\n", PI4, False),
        ("[pi4]\ndtoverlay=uart3\n", PI4, True),
        ("[pi4]\ndtoverlay=uart3\n", PI5, False),
        ("[pi5]\nx=1\n[all]\ndtoverlay=uart3\n", PI4, True),
        ("[none]\ndtoverlay=uart3\n", PI4, False),
        ("", PI4, False),
    ],
)
def test_an_overlay_counts_where_its_section_does(text: str, sections: frozenset[str], found: bool) -> None:
    assert has_overlay(text, sections, "uart3") is found


@pytest.mark.parametrize(
    ("text", "value"),
    [
        (SHIPPED, None),
        ("dtparam=i2c_arm=on\n", "on"),
        ("dtparam=spi=on,i2c_arm=on,i2c_arm_baudrate=400000\n", "on"),
        ("dtparam=i2c_arm\n", "on"),
        ("dtparam=i2c_arm=on\ndtparam=i2c_arm=off\n", "off"),
        ("[pi5]\ndtparam=i2c_arm=on\n", None),
    ],
)
def test_the_last_parameter_counts(text: str, value: str | None) -> None:
    assert parameter(text, PI4, "i2c_arm") == value


@pytest.mark.parametrize(
    "text", [SHIPPED, SHIPPED.rstrip(), "", "[pi5]\nx=1", "[pi5]\nx=1\n[all]\n", "x=1\n"]
)
def test_what_is_added_counts_for_every_model_and_what_was_there_stays(text: str) -> None:
    after = with_lines(text, "the autopilot", ("dtoverlay=uart3", "dtparam=spi=on"))
    assert after.startswith(text)
    for sections in (PI4, PI5):
        assert has_overlay(after, sections, "uart3")
        assert parameter(after, sections, "spi") == "on"
    assert "# companion: the autopilot\n" in after


@pytest.mark.parametrize(
    ("text", "after"),
    [
        (
            "console=serial0,115200 console=tty1 root=/dev/sda rootwait\n",
            "console=tty1 root=/dev/sda rootwait\n",
        ),
        ("root=x console=ttyAMA0,115200 console=ttyS0\n", "root=x\n"),
        ("console=tty1 root=x  quiet\n", "console=tty1 root=x  quiet\n"),
        ("root=x 8250.nr_uarts=1\n", "root=x 8250.nr_uarts=1\n"),
    ],
)
def test_a_console_on_a_serial_line_goes_and_nothing_else(text: str, after: str) -> None:
    assert without_serial_console(text) == after
