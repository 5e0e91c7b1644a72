"""install.sh and companion-rollback on made-up releases: one whole version is in use, whatever happens."""

import fcntl
import re
import shutil
from pathlib import Path
from typing import Final

import pytest

from tests.deploy.releases import PIP, SYSTEMD, System, release

pytestmark = pytest.mark.skipif(PIP is None, reason="this Python has no ensurepip, whose pip they hold")


@pytest.fixture
def empty(tmp_path: Path) -> System:
    return System.made(tmp_path)


@pytest.fixture(scope="module")
def kept_with_1_0(tmp_path_factory: pytest.TempPathFactory) -> tuple[System, Path]:
    """A system with 1.0, installed once for all tests, and a copy: an installed version stays where it is."""
    folder = tmp_path_factory.mktemp("versions")
    system = System.made(folder / "system")
    installed(system, folder, "1.0")
    return system, Path(shutil.copytree(folder / "system", folder / "kept", symlinks=True))


@pytest.fixture
def system(kept_with_1_0: tuple[System, Path]) -> System:
    """Version 1.0 is installed, and nothing has happened since."""
    system, kept = kept_with_1_0
    shutil.rmtree(system.base.parent)
    shutil.copytree(kept, system.base.parent, symlinks=True)
    return system


def installed(system: System, folder: Path, version: str) -> None:
    done = system.run(release(folder, version) / "install.sh")
    assert done.returncode == 0, done.stderr
    assert system.in_use == version


def unit(system: System) -> str:
    return (system.base / "etc/systemd/system/companion.service").read_text().splitlines()[-1]


def test_a_first_installation_starts_nothing_and_puts_the_shipped_settings(
    empty: System, tmp_path: Path
) -> None:
    installed(empty, tmp_path, "1.0")
    assert empty.starts == []
    assert (empty.base / "etc/companion/companion.yaml").read_text() == "# shipped\n"
    assert (empty.base / "var/lib/companion").is_dir()  # the first check asks for room there
    assert (empty.prefix / "current/REVISION").read_text() == "abc\n"
    assert (empty.prefix / "current/configs/companion.yaml").exists()
    assert empty.run(empty.base / "usr/local/bin/companion", "--version").stdout == "1.0\n"


def test_an_upgrade_restarts_a_service_that_stands_by_says_so_and_leaves_settings_and_keys(
    system: System, tmp_path: Path
) -> None:
    token, settings = (system.base / "etc/companion" / name for name in ("page-token", "companion.yaml"))
    token.write_text("secret")
    token.chmod(0o600)
    settings.write_text("# mine\n")
    before = [(path.stat().st_uid, path.stat().st_gid, path.stat().st_mode) for path in (token, settings)]
    system.serves()
    done = system.run(release(tmp_path, "1.1") / "install.sh")
    assert done.returncode == 0, done.stderr
    assert "restarting the service" in done.stdout
    assert (system.in_use, system.starts, unit(system)) == ("1.1", ["1.1"], "# 1.1")
    assert settings.read_text() == "# mine\n"
    assert before == [(p.stat().st_uid, p.stat().st_gid, p.stat().st_mode) for p in (token, settings)]


def test_the_releases_readme_names_nothing_that_a_release_lacks() -> None:
    text = (SYSTEMD / "README.md").read_text()
    links = re.findall(r"\]\(([^)]+)\)", text)
    missing = [link for link in links if not (SYSTEMD.parent / link).is_file()]
    outside = [link for link in links if not link.startswith(("docs/", "CHANGELOG.md", "LICENSE"))]
    assert (missing, outside) == ([], [])
    assert [word for word in ("make ", "checkout", "CONTRIBUTING") if word in text] == []
    assert "systemd/README.md" in (SYSTEMD / "release.sh").read_text()


def test_no_line_of_the_installer_changes_who_owns_the_settings() -> None:
    text = (SYSTEMD / "install.sh").read_text() + (SYSTEMD / "versions.sh").read_text()
    commands = [line for line in text.splitlines() if "chown" in line and "${AS_ROOT}chown" not in line]
    assert commands == []


def test_the_way_back_is_laid_before_the_switch_and_is_as_it_was_when_that_is_taken_back(
    system: System, tmp_path: Path
) -> None:
    installed(system, tmp_path, "1.1")  # nothing runs
    system.serves()
    done = system.run(release(tmp_path, "1.2", fault="fault") / "install.sh")
    assert done.returncode == 1
    # while 1.2 started, of which a power cut would leave nothing but the links; and in the end
    assert (system.starts, (system.prefix / "previous").readlink().name) == (["1.2", "1.1"], "1.0")
    done = system.run(release(tmp_path, "1.3") / "install.sh")
    assert done.returncode == 0, done.stderr
    assert (system.base / "way_back").read_text() == "1.1\n"


def test_one_that_does_not_come_up_is_taken_back_with_the_service_up(system: System, tmp_path: Path) -> None:
    system.serves()
    done = system.run(release(tmp_path, "1.1", fault="fault") / "install.sh")
    assert done.returncode == 1
    assert "1.1 was taken back; 1.0 is in use, the service runs" in done.stderr
    assert (system.in_use, system.starts, unit(system)) == ("1.0", ["1.1", "1.0"], "# 1.0")
    assert (system.base / "active").exists()


@pytest.mark.parametrize("fault", [False, True])
def test_a_service_that_crashes_again_and_again_is_restarted_and_checked_too(
    fault: bool, empty: System
) -> None:
    """GIVEN systemd is about to start it again WHEN switched THEN the new version is checked like any."""
    empty.has("1.0", "1.1")
    (empty.base / "state").write_text("activating\n")
    empty.will_answer("after-start")
    if fault:
        (empty.prefix / "versions/1.1/configs").mkdir()
        (empty.prefix / "versions/1.1/configs/fault").touch()
    done = empty.run(SYSTEMD / "companion-rollback", "1.1")
    if fault:
        assert (done.returncode, empty.in_use, empty.starts) == (1, "1.0", ["1.1", "1.0"]), done.stderr
    else:
        assert (done.returncode, empty.in_use, empty.starts) == (0, "1.1", ["1.1"]), done.stderr
        assert "1.1 is in use; the service runs, and answers" in done.stdout


def test_one_that_runs_and_says_nothing_is_told_apart_from_one_that_went_down(
    system: System, tmp_path: Path
) -> None:
    system.serves()
    (system.programs / "journalctl").write_text("#!/bin/sh\necho 'NEO-6M: nothing received'\n")
    done = system.run(release(tmp_path, "1.1", fault="mute") / "install.sh")
    assert done.returncode == 1
    assert (
        "1.1: it runs and gives no answer within 2 s; last it said: NEO-6M: nothing received" in done.stdout
    )
    assert system.in_use == "1.0"


def test_one_that_systemd_ended_is_told_with_systemds_reason(system: System, tmp_path: Path) -> None:
    system.serves()
    said = "companion.service: Watchdog timeout (limit 2s)!\\ncontrol 23 ms late\\nStopped companion.service"
    (system.programs / "journalctl").write_text(f"#!/bin/sh\nprintf '{said}'\n")
    done = system.run(release(tmp_path, "1.1", fault="fault") / "install.sh")
    assert done.returncode == 1
    assert "1.1: it does not start: Watchdog timeout (limit 2s)! (too busy a machine?)" in done.stdout
    assert "; last it said: control 23 ms late" in done.stdout


@pytest.mark.parametrize(
    ("status", "why"),
    [
        ({"armed": True}, "the vehicle is armed"),
        ({"phase": "descend", "order": "land by RC"}, "the service is in descend, land by RC"),
        ({"phase": "abort"}, "the service is in abort"),
    ],
)
def test_in_flight_nothing_is_changed(
    status: dict[str, object], why: str, system: System, tmp_path: Path
) -> None:
    system.serves(**status)
    done = system.run(release(tmp_path, "1.1") / "install.sh")
    assert done.returncode == 2
    assert f"{why}: nothing was changed" in done.stderr
    assert (system.in_use, system.starts, system.versions) == ("1.0", [], {"1.0"})
    removal = system.run(release(tmp_path / "again", "1.1") / "install.sh", "--remove")
    assert removal.returncode == 2
    assert system.in_use == "1.0"


def test_an_order_that_comes_during_the_switch_keeps_the_service_from_being_restarted(empty: System) -> None:
    empty.has("1.0", "1.1")
    empty.serves()
    empty.will_answer("after-switch", phase="descend", order="land by RC")
    done = empty.run(SYSTEMD / "companion-rollback", "1.1")
    assert done.returncode == 1
    assert "the service is in descend, land by RC; going back to 1.0" in done.stdout
    assert (empty.in_use, empty.starts, unit(empty)) == ("1.0", [], "# 1.0")


def test_a_new_version_that_flies_already_is_not_restarted_to_take_it_back(empty: System) -> None:
    """GIVEN an order to the new version WHEN its check is interrupted THEN it stays in use, and flies on."""
    empty.has("1.0", "1.1")
    empty.serves()
    empty.will_answer("after-start", phase="descend", order="land by RC")
    waits = empty.programs / "sleep"  # in a subshell of the script
    waits.write_text('#!/bin/sh\nkill -TERM "$(cut -d " " -f 4 /proc/$PPID/stat)"\n')
    waits.chmod(0o755)
    done = empty.run(SYSTEMD / "companion-rollback", "1.1")
    assert done.returncode == 1
    assert "1.1: interrupted; the service is in descend, land by RC: 1.1 stays in use" in done.stderr
    assert (empty.in_use, empty.starts, unit(empty)) == ("1.1", ["1.1"], "# 1.1")


CHECKS: Final = """#!/bin/sh
[ "$1" = -c ] || [ "$COMPANION_SERVE_TOKEN $OTHER" = "two words 3" ] || {
    echo "no token, found '$COMPANION_SERVE_TOKEN'" >&2
    exit 2
}
"""


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ('Environment="COMPANION_SERVE_TOKEN=two words" OTHER=3', 0),
        ('Environment = \\\n  "COMPANION_SERVE_TOKEN=two words" \\\n OTHER=3', 0),
        ("EnvironmentFile=ROOT/token", 0),
        ("# Environment=COMPANION_SERVE_TOKEN=x", 2),
    ],
)
def test_settings_are_checked_in_the_environment_that_the_service_has(
    line: str, code: int, empty: System
) -> None:
    empty.has("1.0", "1.1")
    checks = empty.prefix / "versions/1.1/.venv/bin/python"
    checks.write_text(CHECKS)
    checks.chmod(0o755)
    (empty.base / "etc/companion/companion.yaml").touch()
    (empty.base / "token").write_text('COMPANION_SERVE_TOKEN="two words"\nOTHER=3\n')
    unit_file = empty.base / "etc/systemd/system/companion.service"
    unit_file.write_text("[Service]\nEnvironment=OTHER=2\n")
    (unit_file.parent / "companion.service.d").mkdir()
    own = unit_file.parent / "companion.service.d/token.conf"
    own.write_text(f"[Service]\n{line.replace('ROOT', str(empty.base))}\n")
    done = empty.run(SYSTEMD / "companion-rollback", "1.1")
    assert (done.returncode, empty.in_use) == ((0, "1.1") if code == 0 else (2, "1.0")), done.stderr
    assert ("1.1 does not start with these settings" in done.stderr) is (code != 0)


def test_a_service_that_runs_and_does_not_answer_is_not_restarted(system: System, tmp_path: Path) -> None:
    (system.base / "active").touch()
    done = system.run(release(tmp_path, "1.1") / "install.sh")
    assert done.returncode == 2
    assert "the service runs and does not answer: nobody answers" in done.stderr
    assert (system.in_use, system.starts) == ("1.0", [])


def test_without_a_package_it_needs_nothing_is_changed_and_one_line_says_so(
    system: System, tmp_path: Path
) -> None:
    system.serves()
    done = system.run(release(tmp_path, "1.1", needs="no-such-package") / "install.sh")
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert "nothing was changed" in line
    assert "no-such-package" in line
    assert (system.in_use, system.starts, system.versions) == ("1.0", [], {"1.0"})


@pytest.mark.slow
def test_from_a_checkout_without_a_network_nothing_is_changed_and_one_line_says_so(
    system: System, tmp_path: Path
) -> None:
    system.serves()
    done = system.run(SYSTEMD / "install.sh", PIP_NO_INDEX="1", PIP_CONFIG_FILE="/dev/null")
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert "the wheels cannot be built, and nothing was changed: ERROR: " in line
    assert (system.in_use, system.starts, system.versions) == ("1.0", [], {"1.0"})


def test_where_it_cannot_write_nothing_is_changed_and_one_line_says_so(
    system: System, tmp_path: Path
) -> None:
    bundle, programs = release(tmp_path, "1.1"), system.base / "usr/local/bin"
    programs.rename(system.base / "elsewhere")
    programs.write_text("no folder")
    done = system.run(bundle / "install.sh")
    assert done.returncode == 2
    assert "usr/local/bin cannot be written to, and nothing was changed" in done.stderr
    assert (system.in_use, system.versions) == ("1.0", {"1.0"})


def test_two_installations_do_not_run_at_once(system: System, tmp_path: Path) -> None:
    bundle = release(tmp_path, "1.1")
    with (system.prefix / "lock").open("w") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        for command in ((bundle / "install.sh",), (system.base / "usr/local/bin/companion-rollback", "1.0")):
            done = system.run(*command)
            assert done.returncode == 2, done.stderr
    assert system.in_use == "1.0"


def test_settings_that_are_a_link_to_a_disk_that_is_away_stay(system: System, tmp_path: Path) -> None:
    settings = system.base / "etc/companion/companion.yaml"
    settings.unlink()
    settings.symlink_to("/media/stick/companion.yaml")
    installed(system, tmp_path, "1.1")
    assert settings.readlink() == Path("/media/stick/companion.yaml")


def test_a_damaged_release_is_refused(empty: System, tmp_path: Path) -> None:
    bundle = release(tmp_path, "1.0")
    with (bundle / "constraints.txt").open("a") as file:
        file.write("x")
    done = empty.run(bundle / "install.sh")
    assert done.returncode == 2
    assert "damaged or missing" in done.stderr
    assert empty.in_use is None


def test_a_release_for_another_computer_is_refused(empty: System, tmp_path: Path) -> None:
    bundle = release(tmp_path, "1.0")
    (bundle / "ARCHITECTURE").write_text("riscv64\n")
    done = empty.run(bundle / "install.sh")
    assert (done.returncode, "this release is for riscv64" in done.stderr) == (2, True)


def test_back_by_hand_forward_again_and_the_same_again(system: System, tmp_path: Path) -> None:
    rollback = system.base / "usr/local/bin/companion-rollback"
    assert "there is no version before 1.0" in system.run(rollback).stderr
    system.serves()
    installed(system, tmp_path, "1.1")
    assert system.run(rollback, "--list").stdout == "1.0 (before)\n1.1 (in use)\n"
    assert system.run(rollback).returncode == 0
    assert (system.in_use, system.starts) == ("1.0", ["1.1", "1.0"])
    assert system.run(rollback).returncode == 0
    assert system.in_use == "1.1"
    again = system.run(tmp_path / next(path.name for path in tmp_path.glob("companion-1.1-*")) / "install.sh")
    assert "in use already; the service was left alone" in again.stdout
    assert system.starts == ["1.1", "1.0", "1.1"]
    unknown = system.run(rollback, "7.0")
    assert (unknown.returncode, "7.0 is not installed" in unknown.stderr) == (2, True)


@pytest.mark.slow
def test_the_version_in_use_and_the_one_before_it_are_kept(system: System, tmp_path: Path) -> None:
    for version in ("1.1", "1.2"):
        installed(system, tmp_path, version)
    assert system.versions == {"1.1", "1.2"}


@pytest.mark.slow
def test_another_content_of_the_same_version_gets_a_folder_of_its_own(system: System, tmp_path: Path) -> None:
    system.serves()
    done = system.run(release(tmp_path / "other", "1.0", fault="fault") / "install.sh")
    assert done.returncode == 1
    assert system.in_use == "1.0"
    assert (system.prefix / "versions/1.0/COMPLETE").exists()


@pytest.mark.slow
def test_the_layout_of_0_1_is_kept_until_it_is_not_the_one_before(empty: System, tmp_path: Path) -> None:
    """GIVEN 0.1, straight in /opt/companion WHEN upgraded THEN it can be gone back to, as any version."""
    old = tmp_path / "old"
    shutil.copytree(old_layout(empty, tmp_path), old)
    empty.serves()
    done = empty.run(release(tmp_path, "1.1", fault="fault") / "install.sh")
    assert done.returncode == 1, done.stderr
    assert (empty.in_use, unit(empty)) == ("0.1.0", "# 0.1")
    installed(empty, tmp_path, "1.2")
    assert (empty.prefix / ".venv").exists()
    assert empty.run(empty.base / "usr/local/bin/companion-rollback").returncode == 0
    assert empty.run(empty.base / "usr/local/bin/companion", "--version").stdout == "0.1.0\n"
    installed(empty, tmp_path, "1.3")
    installed(empty, tmp_path, "1.4")
    assert not (empty.prefix / ".venv").exists()
    assert not (empty.prefix / "companion").exists()


def old_layout(system: System, folder: Path) -> Path:
    """What 0.1's installer left, as far as it is seen."""
    programs = system.prefix / ".venv/bin"
    programs.mkdir(parents=True)
    (system.prefix / "companion").mkdir()
    shown = folder / "shown.py"
    shown.write_text(
        "import os, pathlib, sys\n"
        "base = pathlib.Path(os.environ['COMPANION_BASE'])\n"
        "print('0.1.0' if '--version' in sys.argv else (base / 'status.json').read_text())\n"
    )
    (programs / "companion").write_text(f'#!/bin/sh\nexec python3 {shown} "$@"\n')
    (programs / "companion").chmod(0o755)
    (system.base / "etc/systemd/system/companion.service").write_text("[Unit]\n# 0.1\n")
    return system.prefix


def test_removed_nothing_but_settings_is_left(system: System, tmp_path: Path) -> None:
    key = system.base / "etc/companion/signing-key"
    key.write_text("secret")
    system.serves()
    bundle = next(system.base.parent.parent.glob("companion-1.0-*"))
    assert system.run(bundle / "install.sh", "--remove").returncode == 0
    assert not system.prefix.exists()
    assert list((system.base / "usr/local/bin").iterdir()) == []
    assert key.read_text() == "secret"


@pytest.mark.parametrize("signal", ["TERM", "HUP"])
def test_a_removal_that_is_interrupted_leaves_nothing_that_leads_to_half_a_version(
    signal: str, system: System, tmp_path: Path
) -> None:
    """GIVEN a signal while the folder is deleted THEN no link, no unit, no version counts as whole."""
    bundle = next(system.base.parent.parent.glob("companion-1.0-*"))
    slow = system.programs / "rm"
    half = 'kill -TERM $PPID; exec /bin/rm -rf "$2/versions/1.0/.venv/bin"' if signal == "TERM" else ""
    slow.write_text(
        f'#!/bin/sh\ncase "$*" in *opt/companion) kill -{signal} $PPID; {half} ;; esac\nexec /bin/rm "$@"\n'
    )
    slow.chmod(0o755)
    done = system.run(bundle / "install.sh", "--remove")
    assert done.stdout.startswith("removing: may take minutes")
    assert list((system.base / "usr/local/bin").iterdir()) == []
    assert not (system.base / "etc/systemd/system/companion.service").exists()
    if signal == "HUP":  # a lost ssh connection
        assert (done.returncode, system.prefix.exists()) == (0, False)
        return
    assert done.returncode == 1
    assert f"interrupted; expected it again: {bundle}/install.sh --remove" in done.stderr
    slow.unlink()
    installed(system, tmp_path, "1.0")
    assert system.run(system.base / "usr/local/bin/companion", "--version").stdout == "1.0\n"


@pytest.mark.parametrize(("user", "root", "service"), [("pilot", "sudo ", "sudo -u"), ("", "", "runuser -u")])
def test_what_to_do_next_is_said_as_who_installs_can_do_it(
    user: str, root: str, service: str, empty: System, tmp_path: Path
) -> None:
    done = empty.run(release(tmp_path, "1.0") / "install.sh", SUDO_USER=user)
    assert f": {root}companion status, {root}companion order land" in done.stdout
    assert f"missing: {service} root " in done.stdout
    assert f"then: {root}systemctl enable" in done.stdout
