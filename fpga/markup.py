"""XML, written as it is to be read."""

from xml.sax.saxutils import escape


def element(name: str, *content: str, attributes: str = "") -> str:
    """An XML element: of text where that has no line of its own, else of lines."""
    if not content:
        return f"<{name}{attributes}/>"
    if len(content) == 1 and "\n" not in content[0] and not content[0].startswith("<"):
        return f"<{name}{attributes}>{escape(content[0])}</{name}>"
    inner = "\n".join(f"  {line}" for part in content for line in part.splitlines())
    return f"<{name}{attributes}>\n{inner}\n</{name}>"
