"""Formulas of the documentation, written as Unicode text (``T·ẋ = u − x``), as MathML, which browsers draw without a script.

Letters are variables, words are text; ``^``, ``_`` and ``√`` raise, lower and take the root of the next part or parentheses.
"""

from __future__ import annotations

import re
import unicodedata
from html import escape

_TOKEN = re.compile(
    r"(?P<mn>[0-9]+(?:\.[0-9]+)?)|(?P<name>[A-Za-z](?:[A-Za-z]|_(?=[A-Za-z]))+|[A-Za-zΑ-ω][\u0307\u0308]?)"
    r"|(?P<msup>[⁰¹²³⁴⁵⁶⁷⁸⁹⁻ᵀ]+)|(?P<msub>[₀₁₂₃₄₅₆₇₈₉]+)|(?P<space>\s+)|(?P<mo>.)"
)
_PLAIN = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻ᵀ₀₁₂₃₄₅₆₇₈₉", "0123456789−T0123456789")
_SCRIPTS = {"^": "msup", "_": "msub"}
_ACCENTS = {"\u0307": "˙", "\u0308": "¨"}


def mathml(text: str) -> str:
    """``text`` as a block of MathML; a line for each of its lines."""
    lines = [f'<math display="block"><mrow>{"".join(_parts(line))}</mrow></math>' for line in text.strip().splitlines()]
    return f'<div class="formula">{"".join(lines)}</div>'


def inline(text: str) -> str:
    """``text`` as MathML inside a sentence."""
    return f"<math><mrow>{''.join(_parts(text))}</mrow></math>"


def _parts(text: str) -> list[str]:
    """The elements of one line; a raised or lowered part joins the element before it."""
    # Decomposed, ẋ is x and its dot.
    tokens = [(str(match.lastgroup), match[0]) for match in _TOKEN.finditer(unicodedata.normalize("NFD", text))]
    found: list[str] = []
    at = 0
    while at < len(tokens):
        kind, value = tokens[at]
        at += 1
        if value in ("^", "_") and found:
            inner, at = _group(tokens, at)
            found[-1] = f"<{_SCRIPTS[value]}>{found[-1]}<mrow>{inner}</mrow></{_SCRIPTS[value]}>"
        elif value == "√" and at < len(tokens):
            inner, at = _group(tokens, at)
            found.append(f"<msqrt>{inner}</msqrt>")
        elif kind in ("msup", "msub") and found:
            found[-1] = f"<{kind}>{found[-1]}<mn>{value.translate(_PLAIN)}</mn></{kind}>"
        else:
            found.append(_element(kind, value))
    return found


def _group(tokens: list[tuple[str, str]], at: int) -> tuple[str, int]:
    """The element after ``^``, ``_`` or ``√``: one token, or what stands in parentheses; and the place behind it."""
    if tokens[at][1] != "(":
        return _element(*tokens[at]), at + 1
    depth, end = 0, at
    while end < len(tokens):
        depth += {"(": 1, ")": -1}.get(tokens[end][1], 0)
        end += 1
        if not depth:
            break
    return "".join(_parts("".join(value for _, value in tokens[at + 1 : end - 1]))), end


def _element(kind: str, value: str) -> str:
    if kind == "space":
        return '<mspace width="0.3em"/>'
    if kind == "name":
        if value[1:] in _ACCENTS:
            return f"<mover><mi>{value[0]}</mi><mo>{_ACCENTS[value[1:]]}</mo></mover>"
        if value[1:2] == "_":
            return f"<msub><mi>{value[0]}</mi><mtext>{value[2:]}</mtext></msub>"
        return f"<mi>{value}</mi>" if len(value) == 1 else f"<mtext>{value}</mtext>"
    return f"<{kind}>{escape(value)}</{kind}>"
