# ruff: noqa: INP001, RUF001 - conf.py imports it from its folder; it is about Unicode
"""Formulas of the site: Unicode, as documents and docstrings have it, becomes LaTeX, and LaTeX becomes MathML.

Documents and docstrings are also read as text, in a terminal and on GitHub. So they write ``‖x^i − x*‖ ≤ e^{−r s}`` and
no LaTeX, and the site recognises these formulas. MathML needs neither a script nor a network.
"""

import re
import unicodedata
from collections.abc import Callable
from typing import NamedTuple
from xml.etree import ElementTree as ET

from docutils.utils.math import tex2unichar
from docutils.utils.math.latex2mathml import tex2mathml

# --- Unicode to LaTeX ------------------------------------------------------------------------------------------------

GREEK = "α-ωΑ-Ωϑ"
RELATIONS = {"=": "=", "≠": r"\ne ", "≈": r"\approx ", "<": "<", ">": ">", "≤": r"\le ", "≥": r"\ge ", "∈": r"\in ",
             "→": r"\to ", "~": r"\sim ", "≪": r"\ll ", "≻": r"\succ ", "≺": r"\prec ", "⊥": r"\perp ", "≡": r"\equiv ",
             "∝": r"\propto ", "←": r"\leftarrow "}  # fmt: skip
BINARY = {"+": "+", "−": "-", "·": r"\cdot ", "×": r"\times ", "/": "/", "±": r"\pm ", "⊗": r"\otimes ", "∘": r"\circ "}
PREFIXES = {"−": "-", "+": "+", "±": r"\pm ", "Σ": r"\sum ", "Π": r"\prod ", "∏": r"\prod ", "∫": r"\int ",
            "∂": r"\partial ", "∇": r"\nabla "}  # fmt: skip
BAR = "∣"
"""Stands for the escaped bar of tables while they are read."""
BRACKETS = {"(": ("(", ")", ")"), "[": ("[", "]", "]"), "{": (r"\{", "}", r"\}"), "‖": (r"\lVert ", "‖", r"\rVert "),
            "⌊": (r"\lfloor ", "⌋", r"\rfloor "), "⌈": (r"\lceil ", "⌉", r"\rceil "),
            "|": (r"\lvert ", "|", r"\rvert "), BAR: (r"\lvert ", BAR, r"\rvert ")}  # fmt: skip
FUNCTIONS = {"ln", "exp", "tanh", "cosh", "sinh", "sin", "cos", "min", "max", "log"}
OPERATORS = {"diag", "blockdiag", "col", "sign", "round", "Re", "var", "sym", "std"}
UNITS = r"(?:ms|s|m)(?![\w^*'{(]| [=<>≤≥+−·])"
SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺ᵀᴺ", "0123456789-+TN")
SUBSCRIPTS = str.maketrans("₀₁₂₃₄₅₆₇₈₉₊₋ₖᵢⱼₙ", "0123456789+-kijn")
ACCENTS = {"\u0304": r"\bar", "\u0302": r"\hat", "\u0303": r"\tilde", "\u0307": r"\dot"}
WORDS_AS_INDEX = {"min", "max", "end", "mean", "own", "eff"}

_WORD = re.compile(rf"[A-Za-z{GREEK}𝐱ℝ\u0302-\u0307]+")
_NUMBER = re.compile(r"\d+(?:[.,]\d+)*(?:e[-−+]?\d+(?![\w]))?(?:\s?%)?|½|∞|…")
_SCRIPT = re.compile(
    r"(?P<sup>[⁰¹²³⁴-⁹⁻⁺ᵀᴺ]+)|(?P<sub>[₀-₉₊₋ₖᵢⱼₙ]+)|(?P<star>\\?\*(?![*A-Za-z\d]))|(?P<prime>'(?![A-Za-z]))|(?P<left>←)"
    rf"|(?P<kind>[\^_])(?:\{{(?P<braces>[^{{}}]*)\}}|\((?P<round>[^()]*)\)|\*\*(?P<bold>[A-Z])\*\*"
    rf"|(?P<plain>[-−]?[A-Za-z0-9{GREEK}]+|[∗∞]|\*(?!\*)))"
)
_FUNCTION = re.compile(rf"(log10|log2|{'|'.join(sorted(FUNCTIONS | OPERATORS, key=len, reverse=True))})(?![A-Za-z\d])")
_SPACE = re.compile(r"[ \u00a0]?(?:\n[ \t]*)?")  # two spaces separate the columns of a table
_PRODUCTS = re.compile(r"d[A-Zxtsukvwy]|DF|cT|Nn|hM|iN|kN|gu|[A-Z]x|NB")
_UNIT = re.compile(rf"(?:1/|/)?{UNITS}")
_BOLD = re.compile(r"\*\*([A-Za-zψ])\*\*")
_DIGITS = re.compile(r"\d+(?![\w.,]*[A-Za-z])")
_START = re.compile(rf"[A-Za-z{GREEK}𝐱ℝ\d½∞(\[{{‖|{BAR}⌊⌈√−±ΣΠ∏∫∂∇Δ*+~]")


class Part(NamedTuple):
    """A formula in LaTeX, the end of it in the text, and the number of letters that show that it is a formula."""

    tex: str
    end: int
    evidence: int


class _Reader:
    """Reads the formula that starts at a place of a text, if one does."""

    def __init__(self, text: str, *, bars: bool) -> None:
        self.text = text
        self.bars = bars  # whether | is the bar of |x| and not that of a table

    def space(self, place: int) -> int:
        match = _SPACE.match(self.text, place)
        return match.end() if match else place

    def longest(self, place: int) -> Part | None:
        """The longest formula at a place that ends where a word could end."""
        ends: list[Part] = []
        self.sequence(place, ends=ends)
        return next((part for part in reversed(ends) if _ends_well(self.text, part.end)), None)

    def sequence(self, place: int, closing: str = "", ends: list[Part] | None = None) -> Part | None:
        """Operands and the operators between them; within brackets also commas. ``ends`` collects all beginnings."""
        part = self.operand(place, closing)
        while part is not None:
            if ends is not None:
                ends.append(part)
            following = self.joined(part, closing) or self.factor(part, closing)
            if following is None:
                return part
            part = following
        return None

    def joined(self, part: Part, closing: str) -> Part | None:
        """The part with the next operand, if an operator stands between them, or within brackets a comma."""
        after = self.space(part.end)
        symbol = self.text[after : after + 1]
        right = self.space(after + 1)
        if not symbol or symbol == closing:
            return None
        if symbol in RELATIONS or symbol in BINARY:
            if symbol not in "·×" and (after > part.end) != (right > after + 1):  # 20 /s
                return None
            joint, evidence = RELATIONS.get(symbol) or BINARY[symbol], int(part.evidence > 0)
        elif symbol in ",;:" and closing and closing != "‖":
            joint, evidence = r",\;" if symbol == "," else rf"\mathpunct{{{symbol}}}\;", 0
        else:
            return None
        operand = self.operand(right, closing)
        if operand is None:
            return None
        return Part(part.tex + joint + operand.tex, operand.end, part.evidence + operand.evidence + evidence)

    def factor(self, part: Part, closing: str) -> Part | None:
        """The part with the next operand as its factor."""
        after = self.space(part.end)
        spaced = after > part.end
        if self.text[after : after + 1] in ("", closing):
            return None
        operand = self.operand(after, closing, product=spaced)
        if operand is None:
            return None
        text = self.text[after : operand.end]
        remark = re.search("[=<>≤≥,]", text) or not re.search("[-+−·/^²]", text)  # such as (κ = 2)
        if spaced and not closing and text[0] in "([{" and remark:
            return None
        return Part(part.tex + r"\," * spaced + operand.tex, operand.end, part.evidence + operand.evidence)

    def operand(self, place: int, closing: str = "", *, product: bool = False) -> Part | None:
        """A number, a symbol, a function, brackets, or one of these after a prefix; ``product``: after a space."""
        symbol = self.text[place : place + 1]
        part = None
        if symbol == "√":
            part = self.root(place)
        elif symbol in PREFIXES and not (product and symbol in "+−±"):
            part = self.prefixed(place, closing)
        elif symbol in BRACKETS and (self.bars or symbol != "|") and symbol != closing:
            part = self.brackets(place)
        elif _NUMBER.match(self.text, place):
            part = self.number(place, product=product)
        elif _BOLD.match(self.text, place):
            part = self.scripted(_BOLD.sub(r"\\mathbf{\1}", self.text[place : place + 5]), place + 5, evidence=2)
        elif _FUNCTION.match(self.text, place):
            part = self.function(place)
        return part or self.letters(place, product=product, inside=bool(closing))

    def root(self, place: int) -> Part | None:
        inner = self.operand(place + 1)
        if inner is None:
            return None
        plain = inner.tex[1:-1] if inner.tex[:1] == "(" and inner.tex[-1:] == ")" else inner.tex
        return Part(rf"\sqrt{{{plain}}}", inner.end, inner.evidence + 1)

    def prefixed(self, place: int, closing: str) -> Part | None:
        symbol = self.text[place]
        if self.text[place : place + 2] == "Π(":  # the projection
            return None
        tex, end = self.scripts(PREFIXES[symbol], place + 1)
        inner = self.operand(end if symbol in "+−±" else self.space(end), closing)
        joint = "" if symbol in "+−" else " "
        return inner and Part(tex + joint + inner.tex, inner.end, inner.evidence + (symbol not in "+−"))

    def number(self, place: int, *, product: bool) -> Part | None:
        match = _NUMBER.match(self.text, place)
        if match is None or (product and match[0] not in "½∞…"):
            return None
        mantissa, _, exponent = match[0].partition("e")
        tex = {"½": r"\tfrac{1}{2}", "∞": r"\infty ", "…": r"\ldots "}.get(match[0], mantissa.replace(",", "{,}"))
        tex = tex.replace("%", r"\,\%").replace(" %", "%")
        if exponent:
            power = exponent.replace("−", "-")
            tex = f"10^{{{power}}}" if mantissa == "1" else rf"{mantissa} \cdot 10^{{{power}}}"
        part = self.scripted(tex, match.end(), evidence=0)
        if re.match(r"[a-gi](?![\w^(])", self.text[part.end :]):  # a point of a list, such as 5c
            return None
        return part._replace(evidence=int(match[0] == "∞" or part.end > match.end()))

    def scripted(self, tex: str, end: int, *, evidence: int) -> Part:
        tex, end = self.scripts(tex, end)
        return Part(tex, end, evidence)

    def brackets(self, place: int) -> Part | None:
        opening, closing, tex_closing = BRACKETS[self.text[place]]
        words = re.compile(r"‖((?=[^‖]*[A-Za-z]{2})[A-Za-z ]+)‖").match(self.text, place)
        if words:
            tex, end = self.scripts(tex_closing, words.end())
            return Part(rf"{opening}\text{{{words[1]}}}{tex}", end, 1)
        inner = self.sequence(self.space(place + 1), closing)
        if inner is None:
            return None
        end = self.space(inner.end)
        found = self.text[end : end + 1]
        if found != closing and not (found and found in ")]" and closing in ")]" and "," in inner.tex):  # [0, ∞)
            return None
        tex, end = self.scripts(tex_closing if found == closing else found, end + 1)
        return Part(opening + inner.tex + tex, end, inner.evidence + (opening[0] == "\\" and opening != r"\{"))

    def letters(self, place: int, *, product: bool, inside: bool) -> Part | None:
        """A letter with its indices and exponents, or letters that are a product, such as κL and cT."""
        text = self.text
        match = _WORD.match(text, place)
        bare = "".join(c for c in unicodedata.normalize("NFD", match[0]) if c not in ACCENTS) if match else ""
        greek = re.search(f"[{GREEK}]", bare) is not None
        if not match or (len(bare) > 1 and not (greek and len(bare) <= 4) and not _PRODUCTS.fullmatch(bare)):
            return None
        tex = "".join(_letter(letter) for letter in re.findall(f".[{''.join(ACCENTS)}]*", match[0]))
        index = _DIGITS.match(text, match.end()) if greek or bare in "xJcbA" else None
        end = index.end() if index else match.end()
        part = self.scripted(f"{tex}_{{{index[0]}}}" if index else tex, end, evidence=1 + greek)
        alone = part.end == match.end()
        if re.match(r"[\w]|\.[A-Za-z]", text[part.end :].replace("√", " ")[:2]) or (product and self.is_unit(place)):
            return None
        if alone and bare in ("a", "A", "I") and not self.is_variable(place, product=product, inside=inside):
            return None
        return part._replace(evidence=part.evidence + (not alone))

    def is_variable(self, place: int, *, product: bool, inside: bool) -> bool:
        """Whether the lone letter a, A or I is a variable and no word, by the operators around it."""
        before, after = self.text[max(0, place - 2) : place], self.text[place + 1 : place + 6]
        if product and not inside:
            return False
        if re.search(r"[=<>≤≥+−·/⊗]\s?$", before):
            return True
        followed = re.match(r"\s?[=<>≤≥+−·/∈)\]⊗,;‖|]|\(|\s\([A-Z]_|\s11", after) is not None
        return followed and (inside or not re.match("[,;)]", after))

    def is_unit(self, place: int) -> bool:
        """Whether the letter after a number is seconds or metres."""
        return re.search(r"[\d½]\s$", self.text[:place][-2:]) is not None and bool(_UNIT.match(self.text, place))

    def function(self, place: int) -> Part | None:
        match = _FUNCTION.match(self.text, place)
        if match is None:
            return None
        name = match[1]
        tex = {"log10": r"\log_{10}", "log2": r"\log_2", "log": r"\log"}.get(name)
        if tex is None:
            tex = rf"\{name}" if name in FUNCTIONS else rf"\operatorname{{{name}}}"
        tex, end = self.scripts(tex, match.end())
        inner = self.operand(self.space(end))
        if inner is not None and inner.evidence == 0:
            inner = self.sequence(self.space(end))
        if inner is None or (inner.evidence == 0 and name in ("min", "max", "std", "var", "round", "sign", "col")):
            return None
        return Part(f"{tex} {inner.tex}", inner.end, inner.evidence + 1)

    def scripts(self, tex: str, place: int) -> tuple[str, int]:
        """The indices and exponents at a place, in the order of LaTeX: one index and one exponent."""
        below: list[str] = []
        above: list[str] = []
        primes = 0
        while match := _SCRIPT.match(self.text, place):
            if match["sup"]:
                above.append(match["sup"].translate(SUPERSCRIPTS))
            elif match["sub"]:
                below.append(match["sub"].translate(SUBSCRIPTS))
            elif match["star"]:
                above.append(r"\ast ")
            elif match["prime"]:
                primes += 1
            elif match["left"]:
                tex = rf"\overleftarrow{{{tex}}}"
            else:
                if match["plain"] and len(match["plain"]) > 4:
                    break
                content = next(part for part in match.group("braces", "round", "plain", "bold") if part is not None)
                index = rf"\mathbf{{{content}}}" if match["bold"] else _script(content)
                (above if match["kind"] == "^" else below).append(index)
            place = match.end()
        if below:
            tex += f"_{{{' '.join(below)}}}"
        if above:
            tex += f"^{{{' '.join([*above, *[chr(92) + 'prime'] * primes])}}}"
            primes = 0
        return tex + "'" * primes, place


def _letter(letter: str) -> str:
    base, *accents = unicodedata.normalize("NFD", letter)
    tex = {"𝐱": r"\mathbf{x}", "ℝ": r"\mathbb{R}"}.get(base, base)
    for accent in accents:
        tex = rf"{ACCENTS[accent]}{{{tex}}}"
    return tex


def _script(content: str) -> str:
    """An index or exponent: a word, a formula, or letters side by side."""
    if content in WORDS_AS_INDEX:
        return rf"\mathrm{{{content}}}"
    reader = _Reader(content, bars=True)
    part = reader.sequence(0)
    if part is not None and part.end == len(content):
        return part.tex
    if content in "*∗":
        return r"\ast "
    if re.fullmatch(rf"[-−]?[\w{GREEK}]+", content):
        return " ".join(content.replace("−", "-"))
    words = re.sub(r" ?[A-Za-z]{2,} ?", lambda word: rf"\text{{{word[0]}}}", content)
    for table in (RELATIONS, BINARY):
        for symbol, tex in table.items():
            words = words.replace(symbol, tex)
    return words.replace("…", r"\ldots ").replace("∞", r"\infty ")


def _is_formula(text: str, start: int, part: Part) -> bool:
    """Whether the part is a formula: not a number, a unit, an initial, or a word of one letter."""
    found = text[start : part.end]
    after = text[part.end : part.end + 40]
    before = text[max(0, start - 14) : start]
    if part.evidence == 0:
        return False
    if len(found) == 1:
        if found in "aAI" or (found in "sm" and re.search(r"\d\s?$", before)):
            return False
        if found.isupper() and re.match(r"\.\s+[A-Z]", after):
            return found in "TNK" and re.search(r"\b(at|to|before|after|until|for|than)\s$", before) is not None
        if found.isupper() and re.match(r"\.", after) and re.search(r"[A-Z]\.\s$", before):
            return False
    return not re.fullmatch(r"\([a-d]\)", found)


def texts_to_formulas(text: str, formula: Callable[[str], str], *, bars: bool = True) -> str:
    """The text with its formulas replaced.

    Args:
        text: plain text, without code and links.
        formula: makes the source of a formula from LaTeX.
        bars: whether ``|`` may be the bar of |x|.
    """
    text = re.sub(r"(?<!\w)[À-ÖØ-öø-ſ](?!\w)", lambda match: unicodedata.normalize("NFD", match[0]), text)
    reader, result, place = _Reader(text, bars=bars), [], 0
    while place < len(text):
        symbol = text[place]
        previous = text[place - 1] if place else " "
        emphasis = re.search(r"(^|[\s(])\*\*$", text[max(0, place - 3) : place])
        within = (
            previous.isalnum()
            or (previous in "_`\\^*.@#$&-/:" and not emphasis)
            or re.search(r"\w'$", text[max(0, place - 2) : place])
        )
        opens = _START.match(symbol) and not within
        unit = _UNIT.match(text, place) if opens or symbol == "/" else None
        if unit and re.search(r"[\d½] ?$", text[max(0, place - 3) : place]):
            result.append(unit[0])
            place = unit.end()
            continue
        part = reader.longest(place) if opens else None
        if part is not None and _is_formula(text, place, part):
            result.append(formula(part.tex))
            place = part.end
        else:
            word = re.compile(r"\*\*[A-Za-z]\*\*|[A-Za-z]+|\d[\d.,]*|.", re.DOTALL).match(text, place)
            result.append(word[0] if word else symbol)
            place = word.end() if word else place + 1
    return unicodedata.normalize("NFC", "".join(result))


def leading_formulas(text: str) -> tuple[str, str]:
    """The formulas with which a text begins, with commas between them, as LaTeX for display, and the rest of it."""
    reader, found, place = _Reader(text, bars=True), [], 0
    while (part := reader.longest(place)) is not None and _is_formula(text, place, part) and part.end > place + 2:
        found.append(part.tex)
        comma = re.compile(r",\s+").match(text, part.end)
        place = part.end
        if not comma:
            break
        if reader.longest(comma.end()) is None:
            break
        place = comma.end()
    return r", \quad ".join(found), text[place:]


def _ends_well(text: str, end: int) -> bool:
    following = text[end : end + 2]
    return not re.match(r"[\w`^@]|[/(\[][A-Za-z]", following)


# --- documents -------------------------------------------------------------------------------------------------------

_KEPT_IN_MARKDOWN = re.compile(
    r"^(?P<fence>`{3,}|~{3,}).*?^(?P=fence)[ ]*$|^#+ .*?$|^\|[ :|-]+\|$|^\[[^\]]+\]: .*?$|^\([\w-]+\)=$"
    r"|(?P<code>`+)[^`].*?(?P=code)(?:s\b)?|\$\$[^$]+\$\$|\$[^$]+\$|!\[[^\]]*\]|\]\([^)]*\)|<[^<>\s][^<>]*>"
    r"|https?://\S+|\b(?:n/a|N/A|C-contiguous)\b",
    re.MULTILINE | re.DOTALL,
)


def typeset_markdown(text: str) -> str:
    """A Markdown document with its formulas between dollar signs; code, links, headings and LaTeX stay as they are."""
    rows: list[str] = []
    for table, lines in _tables_apart(text):
        rows.append(_outside(_KEPT_IN_MARKDOWN, lines, lambda plain, table=table: _dollars(plain, bars=not table)))
    return "".join(rows)


def _tables_apart(text: str) -> list[tuple[bool, str]]:
    """The text in pieces: a row of a table is a piece of its own."""
    pieces: list[tuple[bool, str]] = []
    fenced = False
    for line in text.splitlines(keepends=True):
        row = line.startswith("|") and not fenced
        fenced ^= line.startswith(("```", "~~~"))
        if row or not pieces or pieces[-1][0]:
            pieces.append((row, line))
        else:
            pieces[-1] = (False, pieces[-1][1] + line)
    return pieces


def _dollars(text: str, *, bars: bool) -> str:
    if bars:
        return texts_to_formulas(text, lambda tex: f"${tex.strip()}$")
    return texts_to_formulas(text.replace(r"\|", BAR), lambda tex: f"${tex.strip()}$", bars=False).replace(BAR, r"\|")


def _outside(kept: re.Pattern[str], text: str, change: Callable[[str], str]) -> str:
    """Change the text between the parts that are kept."""
    result, place = [], 0
    for match in kept.finditer(text):
        result += [change(text[place : match.start()]), match[0]]
        place = match.end()
    return "".join([*result, change(text[place:])])


_KEPT_IN_DOCSTRINGS = re.compile(
    r"``.*?``|\bC-contiguous\b|:[\w:]+:`[^`]*`|`[^`]*`_*|^\s*:\w+ [^:\n]*:|^\s*:\w+:|^\s*>>>.*?$|^\s*\.\. .*?$"
    r"|https?://\S+"
    r"|::\n\n(?:[ ]+.*\n|\n)+",
    re.MULTILINE,
)


_TABLE = re.compile(r"^ *=+(?: +=+)+\n(?:.*\n)*?(?: *=+(?: +=+)+\n)(?:.*\n)*?(?: *=+(?: +=+)+)$", re.MULTILINE)


def typeset_docstring(text: str) -> str:
    """A docstring in reStructuredText with its formulas as roles; code, references and names of fields stay.

    Only the last column of a table is changed, because its text may be of any length.
    """

    def role(plain: str) -> str:
        marked = texts_to_formulas(plain, lambda tex: f"\0:math:`{tex.strip()}`\0")
        marked = re.sub(r"(?<=[\s\"'(\[{</-])\0:math:|^\0:math:", ":math:", marked).replace("\0:math:", r"\ :math:")
        return re.sub(r"`\0(?=[\s\"')\]}>/.,;!?:-]|$)", "`", marked).replace("`\0", r"`\ ")

    def last_column(match: re.Match[str]) -> str:
        rule, *rows = match[0].splitlines(keepends=True)
        start = rule.rstrip().rfind(" ") + 1
        return rule + "".join(row[:start] + (row[start:] if "==" in row else around(row[start:])) for row in rows)

    def around(plain: str) -> str:
        return _outside(_KEPT_IN_DOCSTRINGS, plain, role)

    pieces, place = [], 0
    for table in _TABLE.finditer(text):
        pieces += [around(text[place : table.start()]), last_column(table)]
        place = table.end()
    return "".join([*pieces, around(text[place:])])


# --- LaTeX to MathML -------------------------------------------------------------------------------------------------

_NAMESPACE = "http://www.w3.org/1998/Math/MathML"
_RELATION_SIGNS = frozenset("=≠≈<>≤≥∈→⟶∼≪≻≺⟂≡∝⇒")
_WIDE, _WIDE_BLOCK = 9.0, 18.0  # lengths up to which a formula stays in one piece


def mathml(tex: str, *, block: bool) -> tuple[str, float]:
    """A formula as MathML, in pieces between which a line may break: browsers do not break within an element.

    Returns:
        The elements, and the length of the longest piece in widths of the letter m, estimated.

    Raises:
        docutils.utils.math.MathError: for LaTeX that docutils does not know.
    """
    source = tex2mathml(tex, as_block=block).replace("&ApplyFunction;", "\u2061")
    source = re.sub(
        r'<mo( class="mathopen")?>(?=[‖|])',  # by default the left one of a pair stretches, and the right one has a gap
        lambda match: f'<mo stretchy="false" form="{"prefix" if match[1] else "postfix"}">',
        source,
    )
    ET.register_namespace("", _NAMESPACE)
    whole = ET.fromstring(source)  # noqa: S314 - written by docutils
    for element in whole.iter():
        if (element.text or "").strip() == "/":
            element.attrib.update(lspace="0", rspace="0")
    _space_functions(whole)
    pieces: list[list[ET.Element]] = [[]]
    gaps: set[int] = set()  # pieces before which the formula has a wide space
    depth = 0
    breaks = sum(map(_length, whole)) > (_WIDE_BLOCK if block else _WIDE)
    for element in whole:
        name, sign = element.tag.rpartition("}")[2], (element.text or "").strip()
        if breaks and name == "mo" and _may_break_before(sign, pieces[-1], depth):
            pieces.append([])
            element.set("form", "infix")
        depth += _opened(element)
        if breaks and name == "mspace" and depth == 0 and element.get("width") in ("1em", "2em"):
            gaps.add(len(pieces))
            pieces.append([])
        else:
            pieces[-1].append(element)
        if breaks and sign == "," and sum(map(_length, pieces[-1])) > _WIDE:
            pieces.append([])
    attributes = {"displaystyle": "true"} if block else {}
    elements = "".join(
        ("&emsp;<wbr>" if place in gaps else "<wbr>") * bool(place) + _element(piece, attributes)
        for place, piece in enumerate(pieces)
        if piece
    )
    return elements, max(sum(map(_length, piece)) for piece in pieces)


def _space_functions(parent: ET.Element) -> None:
    """Put thin spaces around functions such as tanh, which browsers leave out: before brackets there is none."""
    for child in parent:
        _space_functions(child)
    if parent.tag.rpartition("}")[2] not in ("math", "mrow", "mstyle", "mtd", "msqrt"):
        return
    thin = f"{{{_NAMESPACE}}}mspace", {"width": "0.167em"}
    for place, child in reversed(list(enumerate(parent))):
        if not _is_function(child):
            continue
        after = [each for each in parent[place + 1 : place + 3] if each.text != "\u2061"]
        if after and _opened(after[0]) <= 0 and after[0].tag.rpartition("}")[2] not in ("mo", "mspace"):
            parent.insert(list(parent).index(after[0]), ET.Element(*thin))
        if place and (parent[place - 1].tag.rpartition("}")[2] not in ("mo", "mspace", "mtext")):
            parent.insert(place, ET.Element(*thin))


def _is_function(element: ET.Element) -> bool:
    """Whether an element is the name of a function, perhaps with an index or exponent."""
    while element.tag.rpartition("}")[2] in ("msub", "msup", "msubsup", "munder"):
        element = element[0]
    text = (element.text or "").strip()
    return element.tag.rpartition("}")[2] in ("mi", "mo") and len(text) > 1 and text.isalpha()


def _may_break_before(sign: str, piece: list[ET.Element], depth: int) -> bool:
    """Before a relation, a plus or a minus, within brackets only where the piece would be very wide."""
    length = sum(map(_length, piece))
    if depth > 0:
        return sign in _RELATION_SIGNS | {"+", "−"} and length > 1.5 * _WIDE
    return (sign in _RELATION_SIGNS and length > _WIDE / 3) or (sign in ("+", "−") and length > _WIDE / 2)


def _opened(element: ET.Element) -> int:
    """1 for an opening bracket, -1 for a closing one, also where it has an index or exponent, 0 otherwise."""
    while element.tag.rpartition("}")[2] in ("msub", "msup", "msubsup"):
        element = element[0]
    sign, form = (element.text or "").strip() or "x", element.get("form")
    return (sign in "([{⌊⌈" or form == "prefix") - (sign in ")]}⌋⌉" or form == "postfix")


def _length(element: ET.Element) -> float:
    name, text = element.tag.rpartition("}")[2], (element.text or "").strip()
    if name in ("mi", "mn", "mo", "mtext"):
        sign = bool(text) and (text in _RELATION_SIGNS or text in "+−·×")
        return 0.55 * len(text) + 0.15 * sum(map(str.isupper, text)) + 0.7 * sign
    lengths = [_length(child) for child in element]
    if name in ("munder", "mover", "munderover"):  # letters above and below are smaller
        return max(lengths[0], *(0.7 * length for length in lengths[1:])) + 0.2
    if name in ("mfrac", "mtable"):
        return max(lengths, default=0.0) + 0.2
    if name == "mtr":
        return sum(lengths) + 0.8 * len(lengths)
    if name in ("msub", "msup", "msubsup"):
        return lengths[0] + 0.75 * max(lengths[1:])
    return sum(lengths) + (0.3 if name in ("mspace", "msqrt") else 0.0)


def _element(piece: list[ET.Element], attributes: dict[str, str]) -> str:
    root = ET.Element(f"{{{_NAMESPACE}}}math", attributes)
    root.extend(piece)
    for element in root.iter():
        if element.tag.rpartition("}")[2] == "mtext":
            element.text = (element.text or "").replace(" ", "\N{NO-BREAK SPACE}")
        element.text = element.text and element.text.strip(" \n")
        element.tail = None
    return ET.tostring(root, encoding="unicode")


def plain(tex: str) -> str:
    """A formula in LaTeX as text, for excerpts: ‖x^i‖."""
    symbols = {
        tex: symbol for table in (RELATIONS, BINARY, PREFIXES) for symbol, tex in table.items() if tex[:1] == "\\"
    }
    for opening, (left, closing, right) in BRACKETS.items():
        symbols |= {left: opening, right: closing}
    symbols |= {r"\infty": "∞", r"\ldots": "…", r"\ast": "*", r"\prime": "'", r"\,": " ", r"\;": " ", r"\quad": " "}
    symbols |= {rf"\{name}": sign for name, sign in tex2unichar.mathalpha.items()}
    group = r"\{((?:[^{}]|\{[^{}]*\})*)\}"
    tex = re.sub(rf"\\[dt]?frac{group}{group}", r"\1/\2", tex)
    for command in sorted(symbols, key=len, reverse=True):
        if command[:1] == "\\":
            end = r"(?![A-Za-z]) ?" if command.strip()[-1].isalpha() else ""
            tex = re.sub(re.escape(command.strip()) + end, symbols[command].replace(BAR, "|"), tex)
    return re.sub(r"\\[A-Za-z]+ ?|[{}]", "", tex).replace("-", "−")
