"""What a page may run and ask for: its own scripts, known by a number used once, and nothing from elsewhere.

Every text from a file is escaped where it is written. This is the second lock: a script that came in by a name that was
not escaped has no number, and does not run. Source: Content Security Policy Level 3 (W3C).
"""

from __future__ import annotations

import re
import secrets

from bokeh.embed import file_html
from bokeh.models import UIElement
from bokeh.resources import INLINE

#: Bokeh's own page with a policy.
_PAGE = """
{% block preamble %}<meta http-equiv="Content-Security-Policy" content="{{ policy }}">{% endblock %}
{% block js_resources %}{{ (borrowed or numbered(bokeh_js, nonce)) | safe }}{% endblock %}
{% block inner_body %}
{{ self.contents() }}
{{ numbered(later(plot_script) if borrowed else plot_script, nonce) | safe }}
{% endblock %}
"""
#: The class of scripts that wait.
LATER = "later"
_RUNS = re.compile(r'^(\s*)<script(?: type="text/javascript")?>', flags=re.MULTILINE)
_OPENING = re.compile(r"^(\s*)<script\b", flags=re.MULTILINE)


def fresh_nonce() -> str:
    """A number that nobody can guess, for one page."""
    return secrets.token_urlsafe(16)


def policy(nonce: str, *, served: bool = False) -> str:
    """The policy of a file that opens without a network; of a page that talks to its own server where ``served``.

    Bokeh makes functions of the code in its models (``CustomJS``), which is ours: hence ``unsafe-eval``.
    """
    own = " 'self'" if served else ""
    return "; ".join(
        (
            "default-src 'none'",
            f"script-src 'nonce-{nonce}' 'unsafe-eval'{own}",
            f"style-src 'unsafe-inline'{own}",
            f"img-src data: blob:{own}",
            f"font-src data:{own}",
            "connect-src" + (own or " 'none'"),
            "base-uri 'none'",
            "form-action 'none'",
        )
    )


def numbered(scripts: str, nonce: str) -> str:
    """Script elements that Bokeh wrote, each at the beginning of a line, with their number.

    Texts in them are JSON, in which no line begins: nothing from a file gets a number.
    """
    return _OPENING.sub(rf'\1<script nonce="{nonce}"', scripts)


def page_of(root: UIElement, title: str, nonce: str = "", borrowed: str = "") -> str:
    """A page of what Bokeh draws, under the policy of a file that asks nothing of a network.

    Scripts that are added to it need its ``nonce``, which is fresh unless given. ``borrowed`` are scripts that bring
    Bokeh where the page shall not hold it itself, and then run what draws, which waits as text.
    """
    nonce = nonce or fresh_nonce()
    known = {"nonce": nonce, "policy": policy(nonce), "numbered": numbered, "borrowed": borrowed, "later": _later}
    return file_html(root, INLINE, title, template=_PAGE, template_variables=known)


def _later(scripts: str) -> str:
    """Scripts as text of the page, for whoever runs them once what they need is there."""
    return _RUNS.sub(rf'\1<script type="text/plain" class="{LATER}">', scripts)
