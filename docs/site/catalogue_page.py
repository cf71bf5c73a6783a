"""Makes docs/catalogue.md from the catalogue of effects, so that the page cannot differ from it.

`python docs/site/catalogue_page.py > docs/catalogue.md` writes the page anew.
"""

from __future__ import annotations

import inspect

from difffric.rig import catalogue
from difffric.rig.catalogue import CATALOGUE, RATIO, Effect

_HEAD = """# The catalogue

`difffric diagnose` looks for the effects on this page. Each section gives the law of one effect
with its source, the keys of its table `[effects.ID]`, the signs that one sees in data, the
effects that it is confused with, and the measurement that separates it from them. The page is
made from `rig/catalogue.py` by `python docs/site/catalogue_page.py`. [effects.md](effects.md) has
the equations of all effects together, and the [glossary](glossary.md) defines the words.
"""


def _write_keys(effect: Effect) -> str:
    rows = [
        f"`{key.name}` (null {key.null:g}, typical {key.typical:g}"
        + (", fixed)" if key.fixed else ")")
        for key in effect.keys
    ]
    return ", ".join(rows)


def _write_section(
    name: str, component: str, law: str, keys: str, signs: tuple[str, tuple[str, ...], str]
) -> str:
    sign, confused, separated = signs
    alike = ", ".join(f"[`{x}`](#{x})" for x in confused) or "nothing of the catalogue"
    return (
        f"## {name}\n\n*{component.replace('_', ' ')}*\n\n{law}\n\n"
        f"- **Keys:** {keys}\n- **One sees:** {sign}.\n- **Confused with:** {alike}.\n"
        f"- **What separates it:** {separated}.\n"
    )


def write_page() -> str:
    """Return the page as Markdown: a section for each effect, and one for the ratio."""
    parts = [_HEAD]
    for effect in CATALOGUE.values():
        law = inspect.getdoc(effect.law) or ""
        signs = effect.sign, effect.confused, effect.separated
        parts.append(_write_section(effect.id, effect.component, law, _write_keys(effect), signs))
    law = "`mu_k = ratio mu_s` with another ratio: a parameter of equation (1) itself."
    keys = "`ratio` (null: the set-up's, typical 0.8)"
    parts.append(_write_section(RATIO, catalogue.FRICTION, law, keys, catalogue.RATIO_SIGNS))
    return "\n".join(parts)


if __name__ == "__main__":
    print(write_page(), end="")
