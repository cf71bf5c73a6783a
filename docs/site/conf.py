"""The docs site: what the repository's pages say, as one browsable place that loads nothing from
elsewhere. `make docs` builds it from the repository's root, so that every relative link of a page
leads to the same file there and in a web view of the repository."""

import re
from pathlib import Path

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.util import logging

HERE = Path(__file__).parent

project = "difffric"
author = "the difffric authors"
language = "en"
extensions = ["sphinx.ext.autodoc", "sphinx.ext.napoleon", "myst_nb"]  # napoleon: "Arguments:"

root_doc = "README"
include_patterns = [
    "*.md",
    "docs/*.md",
    "docs/decisions/*.md",
    "docs/site/reference.rst",
    "examples/*.md",
    "examples/pneumatic_cylinder/*.md",
    "fpga/*.md",
    "fpga/emulator/*.md",
    "notebooks/*.ipynb",
]
# Folders that are not read at all: without this line .venv would be walked.
exclude_patterns = [".*", "out", "src", "tests", "studies", "benchmarks", "**/__pycache__"]

FUNCTION = re.compile(r"<(m[io])>(max|min|sin|cos|tan|arcsin|ln|exp)</\1>(?=(<mo[^>]*>&#x00028;)?)")
"""A function's name in a formula, and whether a bracket follows."""

CONTENTS = {
    "Start": [
        "docs/new_setup",
        "docs/axis",
        "docs/the_paper",
        "docs/glossary",
        "docs/error_bars",
        "examples/README",
        "examples/pneumatic_cylinder/README",
    ],
    "How to": [
        "docs/reduction",
        "docs/acquire",
        "docs/diagnose",
        "docs/plan",
        "docs/ring",
        "docs/monitor",
        "docs/controller",
        "docs/fleet",
        "docs/own_law",
    ],
    "Notebooks": [f"notebooks/{path.stem}" for path in sorted(HERE.parents[1].glob("notebooks/*"))],
    "The model": ["docs/model", "docs/effects", "docs/catalogue"],
    "Reference": ["docs/site/reference", "docs/formats", "docs/card"],
    "Evidence": ["docs/performance", "docs/study", "docs/failing_cases", "docs/sampling"],
    "The project": [
        "docs/architecture",
        "docs/decisions/README",
        "CHANGELOG",
        "CONTRIBUTING",
        "fpga/README",
        "fpga/emulator/README",
    ],
}
"""The pages beside the start page, in the order of the sidebar. A page that is missing here is a
warning, and so an error."""

# Headings get the anchors that a web view of the repository gives them.
myst_heading_anchors = 6
myst_enable_extensions = ["dollarmath"]
myst_update_mathjax = False

# A notebook is run where it stands, and one that fails fails the site.
nb_execution_mode = "force"
nb_execution_timeout = 600
nb_execution_raise_on_error = True
nb_merge_streams = True
nb_ipywidgets_js = {}  # the default is fetched from elsewhere

# Docstrings write code in single backticks.
default_role = "literal"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
add_module_names = False
python_maximum_signature_line_length = 80

html_theme = "furo"
html_title = "difffric"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_search_summary = False  # a page that is opened as a file may not fetch others
html_math_renderer = "mathml"
html_theme_options = {"sidebar_hide_name": False}


def add_contents(app, docname, source):
    """The sidebar's contents, which a web view of these pages would show as raw text."""
    lists = []
    if docname == root_doc:
        lists = [(f":caption: {caption}", pages) for caption, pages in CONTENTS.items()]
    elif docname == "docs/decisions/README":
        lists = [(":glob:", ["docs/decisions/0*"])]
    for option, pages in lists:
        lines = "\n".join(f"/{page}" for page in pages)
        source[0] += f"\n```{{toctree}}\n:hidden:\n{option}\n\n{lines}\n```\n"


def mathml(node: nodes.Element, display: str) -> str:
    """The formula as MathML, which browsers draw by themselves: no script, no fonts to fetch."""
    made = convert(node.astext(), display=display)
    if "\\" in made:  # what the converter does not know it prints as it stands
        logging.getLogger(__name__).warning("not known in a formula: %s", node.astext())
    # A function's name keeps apart from what stands beside it, but for its bracket.
    return FUNCTION.sub(
        lambda found: f'<mo lspace=".17em" rspace="{"0" if found[3] else ".17em"}">{found[2]}</mo>',
        made,
    )


def inline_math(translator, node):
    translator.body.append(mathml(node, "inline"))
    raise nodes.SkipNode


def block_math(translator, node):
    translator.body.append(f'<div class="formula">{mathml(node, "block")}</div>')
    raise nodes.SkipNode


def plain_arrays(app, what, name, thing, options, signature, returned):
    """jax's arrays by the name that everyone uses."""
    short = [part and part.replace("jaxlib._jax.Array", "Array") for part in (signature, returned)]
    return tuple(short)


def copy_start(app, error):
    """The start page is what a folder shows, too."""
    if error is None and app.builder.format == "html":
        out = Path(app.outdir)
        (out / "index.html").write_bytes((out / f"{root_doc}.html").read_bytes())


def setup(app):
    app.add_html_math_renderer("mathml", (inline_math, None), (block_math, None))
    app.connect("source-read", add_contents)
    app.connect("autodoc-process-signature", plain_arrays)
    app.connect("build-finished", copy_start)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
