"""The house in figures: what stands against the rules of CONTRIBUTING, package by package.

    python -m studies.house [PACKAGE ...] [--list]

Counts modules, lines, annotated arguments, functions that are no verbs, constants without a word
and class names that stand for two things. `--list` names each of them, with its place.
"""

from __future__ import annotations

import argparse
import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

SOURCE = Path(__file__).parents[1] / "src" / "difffric"
MOST_MODULES, MOST_LINES = 17, 400
LEAST_ANNOTATED = 0.85
IRREGULAR = frozenset(
    re.findall(
        r"\w+",
        """
        told made found given kept drawn known taken seen spread held led left lost met written
        shown chosen bound built sent begun cut beside said read_back gone cool grown swept put
        """,
    )
)
NOUNS = frozenset(
    re.findall(
        r"\w+",
        """
        speed seed feed need shed embed
        """,
    )
)


@dataclass(frozen=True)
class Module:
    """A file of the package, parsed."""

    path: Path
    text: str
    tree: ast.Module

    @property
    def name(self) -> str:
        """Its place from the package on, as in `rig/friction`."""
        return str(self.path.relative_to(SOURCE).with_suffix(""))

    @property
    def package(self) -> str:
        """The first folder it lies in; empty for the root."""
        return self.name.partition("/")[0] if "/" in self.name else ""


def read_modules(source: Path = SOURCE) -> list[Module]:
    """All modules of the package."""
    found = []
    for path in sorted(source.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        found.append(Module(path, text, ast.parse(text)))
    return found


def docstring(module: Module) -> str | None:
    """What the module says of itself."""
    return ast.get_docstring(module.tree)


def crowded_folders(modules: list[Module]) -> list[str]:
    """Folders with more modules than a reader can keep in mind."""
    count: dict[Path, int] = defaultdict(int)
    for module in modules:
        if module.path.name != "__init__.py":
            count[module.path.parent] += 1
    return [f"{folder}: {n}" for folder, n in count.items() if n > MOST_MODULES]


def long_files(modules: list[Module]) -> list[str]:
    """Files of more than `MOST_LINES` lines."""
    lines = ((m.name, m.text.count("\n")) for m in modules)
    return [f"{name}: {n}" for name, n in lines if n > MOST_LINES]


def functions(module: Module) -> Iterator[tuple[ast.FunctionDef, bool]]:
    """Its functions and methods, and whether each can be called from outside."""

    def walk(node: ast.AST, public: bool) -> Iterator[tuple[ast.FunctionDef, bool]]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.FunctionDef):
                shown = public and (not child.name.startswith("_") or child.name in ("__call__",))
                yield child, shown
                yield from walk(child, False)
            else:
                inner = isinstance(child, ast.ClassDef) and not child.name.startswith("_")
                yield from walk(child, public and (inner or not isinstance(child, ast.ClassDef)))

    yield from walk(module.tree, True)


def bare_arguments(module: Module) -> tuple[int, list[str]]:
    """(arguments of public functions, those without an annotation)."""
    total, bare = 0, []
    for function, public in functions(module):
        if not public:
            continue
        given = function.args
        listed = [*given.posonlyargs, *given.args, *given.kwonlyargs]
        listed += [x for x in (given.vararg, given.kwarg) if x]
        for argument in listed:
            if argument.arg in ("self", "cls"):
                continue
            total += 1
            if argument.annotation is None:
                bare.append(f"{module.name}:{function.lineno} {function.name}({argument.arg})")
    return total, bare


KEPT = {"extended"}
"""Public names from before the rule, which users' scripts call."""


def no_verbs(module: Module) -> list[str]:
    """Functions called by a participle: `moved`, `settled_first`, `told`. Properties may be."""
    found = []
    for function, _ in functions(module):
        marks = {ast.unparse(x).rpartition(".")[2] for x in function.decorator_list}
        if marks & {"property", "cached_property", "setter"}:
            continue
        words = function.name.strip("_").split("_")
        ends = (words[0], words[-1])
        participle = any(w in IRREGULAR or (re.fullmatch(r"\w{2,}ed", w) and w not in NOUNS)
                         for w in ends)  # fmt: skip
        asks = words[0] in ("is", "are", "has", "have", "may", "can", "was", "were", "needs")
        known = words[0] in VERBS or function.name in KEPT
        if participle and not asks and not known:
            found.append(f"{module.name}:{function.lineno} {function.name}")
    return found


VERBS = frozenset(
    re.findall(
        r"\w+",
        """
        add append apply ask average begin bind bound build call check choose clear close collect
        combine compare compile compute count cover cut describe draw drop emulate end estimate
        evaluate expect find fit follow format gather get give group hold integrate invert iterate
        join keep know leave list load locate look lose make mark measure merge move name note open
        order pack pad parse pick place plot pool predict prepare print put raise read record reduce
        refit remove rename render repeat replace report require reset resolve restore return run
        sample save scan score search seek select send set settle show simulate skip solve sort
        split stack start step stop store stream sum tabulate take tell test time track trace try
        update use
        spread validate walk warm warn weight whiten write
        """,
    )
)
"""First words that make a name a deed, whatever its last word is: `find_shared`, `drop_unused`."""


def wordless_constants(module: Module) -> list[str]:
    """Numbers at a module's top that no comment and no string beside them explains."""
    lines, found = module.text.split("\n"), []
    body = module.tree.body
    for k, node in enumerate(body):
        if isinstance(node, ast.Assign):
            targets, value = node.targets, node.value
        elif isinstance(node, ast.AnnAssign) and node.value is not None:
            targets, value = [node.target], node.value
        else:
            continue
        names = [n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)]
        if not names or not all(re.fullmatch(r"_?[A-Z][A-Z0-9_]*", n) for n in names):
            continue
        parts = value.elts if isinstance(value, ast.Tuple) else [value]
        if not all(_is_number(x) for x in parts):
            continue
        after = body[k + 1] if k + 1 < len(body) else None
        told = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
        near = lines[node.lineno - 2 : node.end_lineno]
        if not told and not any("#" in line for line in near):
            found.append(f"{module.name}:{node.lineno} {', '.join(names)}")
    return found


def _is_number(node: ast.expr) -> bool:
    if isinstance(node, ast.UnaryOp):
        return _is_number(node.operand)
    if isinstance(node, ast.BinOp):
        return _is_number(node.left) and _is_number(node.right)
    return isinstance(node, ast.Constant) and type(node.value) in (int, float)


def names_twice(modules: list[Module]) -> list[str]:
    """Class names (and type aliases) that stand for two things."""
    places: dict[str, list[str]] = defaultdict(list)
    for module in modules:
        for node in module.tree.body:
            if isinstance(node, ast.ClassDef):
                places[node.name.lstrip("_")].append(module.name)
    return [f"{name}: {', '.join(at)}" for name, at in sorted(places.items()) if len(at) > 1]


def annotated_share(modules: list[Module]) -> float:
    """The share of public functions' arguments that say their type."""
    counts = [(n, len(bare)) for n, bare in map(bare_arguments, modules)]
    total = sum(n for n, _ in counts)
    return 1 - sum(bare for _, bare in counts) / max(total, 1)


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("package", nargs="*")
    parser.add_argument("--list", action="store_true")
    asked = parser.parse_args()
    modules = read_modules()
    packages = sorted({m.package for m in modules})
    print(
        f"{'package':<16}{'modules':>8}{'lines':>8}{'annotated':>11}{'no verb':>9}{'wordless':>10}"
    )
    for package in packages:
        if asked.package and package not in asked.package:
            continue
        own = [m for m in modules if m.package == package]
        verbs = [x for m in own for x in no_verbs(m)]
        words = [x for m in own for x in wordless_constants(m)]
        lines = sum(m.text.count("\n") for m in own)
        share = annotated_share(own)
        print(f"{package or '(root)':<16}{len(own):>8}{lines:>8}{share:>11.1%}"
              f"{len(verbs):>9}{len(words):>10}")  # fmt: skip
        if asked.list:
            bare = [x for m in own for x in bare_arguments(m)[1]]
            for kind, found in (("bare", bare), ("no verb", verbs), ("wordless", words)):
                for line in found:
                    print(f"    {kind}: {line}")
    print(f"annotated in all: {annotated_share(modules):.1%}")
    for title, found in (
        ("folders above 17 modules", crowded_folders(modules)),
        ("files above 400 lines", long_files(modules)),
        ("class names for two things", names_twice(modules)),
    ):
        print(f"{title}: {len(found)}")
        for line in found:
            print(f"    {line}")


if __name__ == "__main__":
    main()
