"""config.txt and cmdline.txt: what counts for a model is found, and what is added counts."""

import pytest

from companion.tools.setup.boot_files import has_overlay, parameter, with_lines, without_serial_console

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
