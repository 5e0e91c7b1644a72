"""How large a folder and a function may grow: a reader takes in each at a time."""

import ast
import subprocess
import sys
from collections import Counter, defaultdict
from graphlib import TopologicalSorter
from pathlib import Path

import grimp

ROOT = Path(__file__).resolve().parents[2]
CODE = ("companion", "sitl", "calibration", "tests", "benchmarks", "experiments")
PACKAGES = ("companion", "sitl", "calibration")
MOST_MODULES_IN_A_FOLDER = 18
MOST_LINES_IN_A_FUNCTION = 60


def modules(*tops: str) -> list[Path]:
    found = [path.relative_to(ROOT) for top in tops for path in sorted((ROOT / top).rglob("*.py"))]
    assert len(found) > 100
    return found


def is_command(function: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """A command of Typer's: its arguments are the list of its options."""
    names = {ast.unparse(decorator).split("(")[0].rpartition(".")[2] for decorator in function.decorator_list}
    return bool(names & {"command", "callback"})


def test_no_folder_has_more_modules_than_a_reader_keeps_apart() -> None:
    counts = Counter(path.parent for path in modules(*CODE) if path.name != "__init__.py")
    assert {str(folder): n for folder, n in counts.items() if n > MOST_MODULES_IN_A_FOLDER} == {}


def test_no_function_is_longer_than_a_screen_but_the_lists_of_options() -> None:
    long = {}
    for path in modules(*CODE):
        for node in ast.walk(ast.parse((ROOT / path).read_text())):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and not is_command(node):
                lines = (node.end_lineno or 0) - node.lineno + 1
                if lines > MOST_LINES_IN_A_FUNCTION:
                    long[f"{path}:{node.name}"] = lines
    assert long == {}


def test_the_name_of_a_public_class_stands_for_one_thing() -> None:
    places: defaultdict[str, list[str]] = defaultdict(list)
    for path in modules(*CODE, "docs"):
        for node in ast.parse((ROOT / path).read_text()).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(str(path))
    assert {name: files for name, files in places.items() if len(files) > 1} == {}


# ---------------- Who may import whom: the contracts are in pyproject.toml


def test_no_module_imports_what_it_must_not() -> None:
    command = (sys.executable, "-c", "from importlinter.cli import lint_imports_command as run; run()")
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout[-3000:]
    assert " 0 broken" in done.stdout


def test_the_folders_of_the_planner_import_in_one_direction() -> None:
    graph = grimp.build_graph(*PACKAGES, exclude_type_checking_imports=True, cache_dir=None)
    imports: defaultdict[str, set[str]] = defaultdict(set)
    for importer in graph.find_descendants("companion.plan"):
        for imported in graph.find_modules_directly_imported_by(importer):
            here, there = (".".join(name.split(".")[:3]) for name in (importer, imported))
            if here != there and there.startswith("companion.plan."):
                imports[here].add(there)
    TopologicalSorter(imports).prepare()  # raises a CycleError that names the circle


def test_no_module_imports_itself_by_way_of_others_not_even_late() -> None:
    """Imports within functions count too; those for the type checker alone are none."""
    graph = grimp.build_graph(*PACKAGES, exclude_type_checking_imports=True, cache_dir=None)
    imports = {name: graph.find_modules_directly_imported_by(name) for name in graph.modules}
    TopologicalSorter(imports).prepare()  # raises a CycleError that names the circle
