"""The Python reference: docs/python.md, made from the docstrings. `python -m tests.reference` writes it anew."""

from __future__ import annotations

import ast
import inspect
import textwrap
from pathlib import Path

import layerfix

TARGET = Path(__file__).parents[1] / "docs" / "python.md"
GROUPS = {
    "Meshes and layers": ("load_mesh", "Mesh", "slice_mesh", "slice_like", "LayerStack", "Layer", "read", "write"),
    "Correction": ("correct", "correct_image", "meso_skeleton", "Conflict", "compare_topology", "TopologyChange"),
    "Surfaces": ("surface_mesh",),
    "Outlines and toolpaths": (
        *(
            "trace_contours",
            "Contours",
            "correct_regions",
            "CorrectedRegions",
            "settings_for",
            "PathSettings",
            "plan_toolpaths",
            "Toolpaths",
        ),
        *("suggest_widths", "Widths", "banded", "WidthPlan"),
    ),
    "Build direction": ("orient", "Orientation"),
    "Printers": ("load_printer", "Printer"),
    "Packed rows": ("pack", "unpack"),
    "Errors": ("LayerfixError",),
}


def reference() -> str:
    """The whole page."""
    named = [name for names in GROUPS.values() for name in names]
    missing = set(layerfix.__all__) ^ set(named)
    if missing:
        raise ValueError(f"GROUPS and layerfix.__all__ differ in {', '.join(sorted(missing))}")
    parts = [
        "# Python reference\n\nEvery public name of `layerfix`, from its docstring. `import layerfix` loads nothing"
        " else; a name is loaded when it is first used. Lengths are in mm, angles in degrees.\n"
    ]
    for title, names in GROUPS.items():
        parts.append(f"## {title}\n")
        parts += [_entry(name) for name in names]
    return "\n".join(parts)


def _entry(name: str) -> str:
    thing = getattr(layerfix, name)
    text = inspect.cleandoc(thing.__doc__)
    lines = [f"### {name}\n", "```python", *_signature(thing), "```", "", "```text", text, "```", ""]
    if inspect.isclass(thing):
        lines += _members(thing)
    return "\n".join(lines)


def _tree(thing: object) -> ast.AST:
    return ast.parse(textwrap.dedent(inspect.getsource(thing))).body[0]  # type: ignore[arg-type]


def _signature(thing: object) -> list[str]:
    """As in the source, one argument a line if it is long."""
    tree = _tree(thing)
    if isinstance(tree, ast.ClassDef):
        bases = ", ".join(ast.unparse(base) for base in tree.bases)
        return [f"class {tree.name}({bases}):" if bases else f"class {tree.name}:", *_fields(tree)]
    assert isinstance(tree, ast.FunctionDef)
    return [_head(tree)]


def _head(tree: ast.FunctionDef) -> str:
    returns = f" -> {ast.unparse(tree.returns)}" if tree.returns else ""
    line = f"{tree.name}({ast.unparse(tree.args)}){returns}"
    if len(line) <= 110:
        return line
    arguments = ast.unparse(tree.args).split(", ")
    joined: list[str] = []
    for argument in arguments:  # commas inside brackets do not part arguments
        if joined and joined[-1].count("[") > joined[-1].count("]"):
            joined[-1] += f", {argument}"
        else:
            joined.append(argument)
    body = "".join(f"    {argument},\n" for argument in joined)
    return f"{tree.name}(\n{body}){returns}"


def _fields(tree: ast.ClassDef) -> list[str]:
    fields = [node for node in tree.body if isinstance(node, ast.AnnAssign)]
    return [f"    {ast.unparse(field)}" for field in fields] or ["    ..."]


def _members(thing: type) -> list[str]:
    """Methods and properties that have a docstring: a line each."""
    tree = _tree(thing)
    assert isinstance(tree, ast.ClassDef)
    lines = []
    for node in tree.body:
        text = isinstance(node, ast.FunctionDef) and ast.get_docstring(node)
        if not isinstance(node, ast.FunctionDef) or node.name.startswith("_") or not text:
            continue
        is_property = any(ast.unparse(decorator).endswith("property") for decorator in node.decorator_list)
        arguments = [a for a in ast.unparse(node.args).split(", ") if a not in ("self", "cls")]
        call = node.name if is_property else f"{node.name}({', '.join(arguments)})"
        lines.append(f"- `{call}`: {' '.join(text.split())}")
    return [*lines, ""] if lines else []


if __name__ == "__main__":
    TARGET.write_text(reference(), encoding="utf-8")
    print(f"{TARGET.name}: {len(layerfix.__all__)} names")
