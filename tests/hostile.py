"""Names that try to be more than names: for every generator of code or markup."""

from __future__ import annotations

from hypothesis import strategies as st

#: Each ends a literal, a tag, a docstring, a table or a line somewhere, or is a word of a language.
HOSTILE = (
    "load if __import__('os').system('touch owned') else rows.time", "humidity (%)", "Temp 1", "load-cell", "class",
    '"""', "'''", '\\"""', "\\", "a\\", '"""\n__import__("os").system("touch owned")\n"""', "a\nb", "a\r\nb", "\x0b",
    "{0}", "{{", "%s", "${x}", "`touch owned`", "$(touch owned)", "</script><script>alert(1)</script>", "<!--", "]]>",
    "<img src=x onerror=alert(1)>", "&lt;", "' onmouseover='alert(1)", "[/]", "[red]", "[link=x]", "{% raw %}",
    "{{ 7*7 }}", "time", "position", "joints", "__class__", "p", "rows", "np", "\u202e", "\u2028", "µ", "x=1", "*/",
    "//", "]\nkind = 1", "#", "\x00", "\x1b[31m", "a" * 300, "p.x", ")", "(", "lambda: 0", "f'{1}'", "0", "é", "名",
)  # fmt: skip

names = st.one_of(
    st.sampled_from(HOSTILE),
    st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=12),
    st.lists(st.sampled_from(HOSTILE), min_size=2, max_size=3).map("".join),
)
