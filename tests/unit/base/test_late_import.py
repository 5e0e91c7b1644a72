"""What is imported late is not imported until one of its functions is called, and then it is the real one."""

import subprocess
import sys
from pathlib import Path

import pytest

from companion.base.late_import import imported_late

ROOT = Path(__file__).parents[3]


@pytest.fixture
def slow_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A package whose module `slow` doubles, and whose module `user` takes that from it."""
    package = tmp_path / "late_import_package"
    package.mkdir()
    (package / "__init__.py").write_text("from . import slow, user\n")
    (package / "slow.py").write_text("def double(number):\n    return 2 * number\n")
    (package / "user.py").write_text("from late_import_package.slow import double\n")
    monkeypatch.syspath_prepend(tmp_path)
    for name in ("", ".slow", ".user"):
        monkeypatch.delitem(sys.modules, f"late_import_package{name}", raising=False)
    return "late_import_package"


def test_a_function_of_it_imports_the_module_when_it_is_called(slow_package: str) -> None:
    with imported_late(f"{slow_package}.slow"):
        package = __import__(slow_package)
    assert f"{slow_package}.slow" not in sys.modules
    assert not hasattr(package, "slow")
    assert package.user.double(21) == 42
    assert f"{slow_package}.slow" in sys.modules
    assert package.slow.double is sys.modules[f"{slow_package}.slow"].double


def test_what_is_imported_already_is_left_alone(slow_package: str) -> None:
    package = __import__(slow_package)
    real = package.slow
    with imported_late(f"{slow_package}.slow"):
        assert sys.modules[f"{slow_package}.slow"] is real
    assert sys.modules[f"{slow_package}.slow"] is real
    assert package.slow is real


def test_a_package_that_imports_its_modules_when_asked_for_is_given_the_late_one(
    slow_package: str, tmp_path: Path
) -> None:
    (tmp_path / slow_package / "__init__.py").write_text(
        "def __getattr__(name):\n"
        "    if name == 'slow':\n"
        f"        import {slow_package}.slow as slow\n"
        "        return slow\n"
        "    raise AttributeError(name)\n"
    )
    package = __import__(slow_package)
    with imported_late(f"{slow_package}.slow"):
        double = package.slow.double
    assert f"{slow_package}.slow" not in sys.modules
    assert double(21) == 42
    assert package.slow.double is sys.modules[f"{slow_package}.slow"].double


def test_a_flight_imports_neither_statistics_nor_image_filters_of_scipy() -> None:
    code = (
        "import sys, companion.sim.runner, filterpy.kalman; print(*sys.modules); "
        "import filterpy.stats; print(filterpy.stats.logpdf(1.0, 1.0, 1.0))"
    )
    said = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.splitlines()
    assert not {"scipy.stats", "scipy.ndimage"} & set(said[0].split())
    assert not {"numpy.f2py", "numpy.testing", "jinja2"} & set(said[0].split())
    assert "filterpy.kalman.EKF" in said[0].split()
    assert float(said[1]) == pytest.approx(-0.9189385)
