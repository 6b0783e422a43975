"""The package's modules import each other without a circle, also for type checking alone."""

import ast
from pathlib import Path

import jostle

PACKAGE = Path(jostle.__file__).parent


def imports(file: Path) -> set[str]:
    """The modules of the package that a module imports anywhere, such as `env/_world`."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.ImportFrom):
            folder = file.parents[node.level - 1] if node.level else PACKAGE.parent
            names = [node.module] if node.module else [alias.name for alias in node.names]
        elif isinstance(node, ast.Import):
            folder = PACKAGE.parent
            names = [alias.name for alias in node.names]
        else:
            continue
        for name in names:
            path = folder / name.replace(".", "/")
            if path.is_relative_to(PACKAGE):
                # A package is its `__init__`.
                module = path / "__init__" if path.is_dir() else path
                found.add(str(module.relative_to(PACKAGE)))
    return found


def circles(edges: dict[str, set[str]]) -> set[frozenset[str]]:
    """Sets of modules that reach each other."""
    reached = {name: set(targets) for name, targets in edges.items()}
    for through in edges:
        for targets in reached.values():
            if through in targets:
                targets |= reached[through]
    together = {
        frozenset(other for other in edges if other in reached[name] and name in reached[other])
        for name in edges
    }
    return together - {frozenset()}


def test_no_import_circle() -> None:
    files = {str(it.relative_to(PACKAGE).with_suffix("")): it for it in PACKAGE.rglob("*.py")}
    edges = {name: imports(file) & files.keys() for name, file in files.items()}
    assert "_session" in edges["_swarm"]
    assert "_client" in edges["env/_world"]
    assert "__init__" in edges["aio"]
    assert circles(edges) == set()


def test_a_circle_is_found() -> None:
    edges = {"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a", "e"}, "e": set()}
    assert circles(edges) == {frozenset({"b", "c"})}
    edges["c"].add("a")
    assert circles(edges) == {frozenset({"a", "b", "c"})}
    edges["e"].add("e")
    assert circles(edges) == {frozenset({"a", "b", "c"}), frozenset({"e"})}
