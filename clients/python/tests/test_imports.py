"""Import circles of the package's modules; the list only shrinks."""

import ast
from pathlib import Path

import jostle

PACKAGE = Path(jostle.__file__).parent

CIRCLES = {
    frozenset({"_draw", "_state"}),
    frozenset({"_swarm", "_view"}),
    frozenset({"_commands", "_controller", "_ends", "_link", "_questions", "_stream"}),
}


def imports(file: Path) -> set[str]:
    """The modules beside `file` that it imports anywhere, also for type checking alone."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.ImportFrom) and node.level == 1:
            names = [node.module] if node.module else [alias.name for alias in node.names]
            found.update(name.split(".")[0] for name in names)
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


def test_no_import_circle_but_these() -> None:
    files = {file.stem: file for file in PACKAGE.glob("*.py")}
    edges = {name: imports(file) & files.keys() for name, file in files.items()}
    assert circles(edges) == CIRCLES


def test_a_circle_is_found() -> None:
    edges = {"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a", "e"}, "e": set()}
    assert circles(edges) == {frozenset({"b", "c"})}
    edges["c"].add("a")
    assert circles(edges) == {frozenset({"a", "b", "c"})}
