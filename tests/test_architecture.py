"""The folders are the architecture: what imports what goes one way."""

import ast
import importlib
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = {"drd": ROOT / "drd", "drd_tools": ROOT / "tools" / "drd_tools"}
# Its rclpy is not in the extra dev; `make ros2-test` imports it.
NEEDS_ROS2 = "drd_tools.ros2.node"
# In `drd`, from what knows nothing of the others upwards.
FLOORS = (
    ("arrays", "units", "samples"),
    ("config",),
    ("effects",),
    ("estimation", "fog", "encoders", "ports", "output"),
    ("monitor",),
    ("pipeline", "recording"),
    ("state", "wiring"),
    ("batch", "service"),
    ("commands",),
    ("cli", "__main__"),
)


def rooms(package: str) -> dict[str, set[str]]:
    """What each module or folder at the top of a package imports of its neighbours."""
    found: dict[str, set[str]] = {}
    for file in PACKAGES[package].rglob("*.py"):
        room = file.relative_to(PACKAGES[package]).parts[0].removesuffix(".py")
        found.setdefault(room, set()).update(name for name in imported(file, package) if name != room)
    return found


def imported(file: Path, package: str) -> Iterator[str]:
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names if node.module == package)]
        for name in names:
            first, _, rest = name.partition(".")
            if first == package and rest and not rest.startswith("__version__"):
                yield rest.partition(".")[0]


@pytest.mark.parametrize("package", PACKAGES)
def test_no_two_rooms_import_each_other(package: str) -> None:
    try:
        tuple(TopologicalSorter(rooms(package)).static_order())
    except CycleError as error:
        pytest.fail(f"a circle: {' -> '.join(error.args[1])}")


def test_no_floor_of_the_daemon_imports_a_higher_one() -> None:
    height = {room: i for i, floor in enumerate(FLOORS) for room in floor}
    found = rooms("drd")
    assert found.keys() - {"__init__"} <= height.keys()
    upwards = [(a, b) for a, others in found.items() if a != "__init__" for b in others if height[b] > height[a]]
    assert upwards == []


@pytest.mark.parametrize("package", PACKAGES)
def test_every_module_can_be_imported(package: str) -> None:
    """With the oldest versions of what drd needs, too: `make lowest`."""
    for file in PACKAGES[package].rglob("*.py"):
        *rooms, name = file.relative_to(PACKAGES[package].parent).with_suffix("").parts
        module = ".".join(rooms if name == "__init__" else [*rooms, name])
        if name != "__main__" and module != NEEDS_ROS2:
            importlib.import_module(module)
