"""The templates of all pages, with what they have in common."""

from __future__ import annotations

import html
import re
from typing import TYPE_CHECKING

from markupsafe import Markup

from bayesbl.presentation import words

if TYPE_CHECKING:
    from jinja2 import Environment


def templates(*sheets: str) -> Environment:
    """The templates by name; pages are in the common style, and in these sheets after it."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    loader = PackageLoader("bayesbl.presentation.page", ".")
    environment = Environment(
        loader=loader,
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["glued"] = prose
    environment.globals["style"] = Markup(
        "".join(source(environment, name) for name in ("page.css", *sheets))
    )
    return environment


def source(environment: Environment, name: str) -> str:
    """A file beside the templates, as it is."""
    assert environment.loader is not None
    return environment.loader.get_source(environment, name)[0]


def prose(sentence: str) -> Markup:
    """A sentence as HTML: commands as code, no break inside a quantity or an option."""
    text = html.escape(words.glued(sentence), quote=False)
    text = re.sub(r"`([^`]+)`", r"<code>\1</code>", text)
    return Markup(re.sub(r"(?<![\w-])--[a-z][\w-]*", r'<span class="option">\g<0></span>', text))
