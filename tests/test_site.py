"""The documentation site, built as ``make docs`` builds it, and read from the disk in a browser."""

import html
import json
import re
import sys
from pathlib import Path

import pytest
from processes import run_python

import ptne_env
from ptne_env.world.catalogue import CATALOGUE, DESCRIPTIONS

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [*ROOT.glob("*.md"), *DOCS.glob("*.md"), *(ROOT / "baselines").glob("*.md")]


@pytest.fixture(scope="session")
def site(build_once, tmp_path_factory):
    """The folder of the site. A link without a target, in a document or a docstring, is a warning and so an error."""

    def build():
        folder = tmp_path_factory.mktemp("site")
        (recipe,) = re.findall(r"sphinx-build (.*) \. \$\(OUT\)/site", (ROOT / "Makefile").read_text(encoding="utf-8"))
        run_python("-m", "sphinx", *recipe.split(), ROOT, folder, folder=ROOT)
        return folder

    return build_once("site", build)


@pytest.fixture(scope="session")
def texts(site):
    """The pages by name."""
    return {path.relative_to(site).with_suffix("").as_posix(): path.read_text("utf-8") for path in site.rglob("*.html")}


@pytest.fixture(scope="module")
def formulas():
    """The module that typesets formulas."""
    sys.path.insert(0, str(DOCS))
    yield __import__("formulas")
    sys.path.remove(str(DOCS))


def test_site_is_complete_and_needs_no_network(texts):
    assert {page.relative_to(ROOT).with_suffix("").as_posix() for page in PAGES} <= set(texts)
    assert "docs/index.html" in texts["index"]
    reference = "".join(text for name, text in texts.items() if name.startswith("docs/api/"))
    modules = [".".join(path.relative_to(ROOT).with_suffix("").parts) for path in (ROOT / "ptne_env").rglob("[!_]*.py")]
    missing = [name for name in modules if f'id="module-{name}"' not in reference]
    assert [name for name in missing if not name.startswith("ptne_env.cli")] == []  # the reference of ptne is --help
    for public in (ptne_env.parallel_env, ptne_env.ObservationLayout, ptne_env.laws.Static):
        assert f'id="{public.__module__}.{public.__qualname__}"' in reference
    assert "TypeAliasForwardRef" not in reference
    for text in texts.values():
        assert re.findall(r"<(?:script|link|img|iframe)[^>]*(?:src|href)=\"(?:https?:)?//", text) == []


def prose(text):
    """The article of a page as plain text, without code, formulas, pictures, headings and names of Python."""
    article = text[text.index("<article") : text.index("</article>")]
    for element in ("pre", "code", "math", "svg", "h1", "h2", "h3", "dt"):
        article = re.sub(rf"<{element}\b.*?</{element}>", " ", article, flags=re.DOTALL)
    return html.unescape(re.sub(r"<[^>]+>", "", article))


def test_formulas_are_typeset_on_all_pages(texts):
    """No sign that only formulas have is left in the prose, but for a few formulas with words in them."""
    left = [
        (name, found)
        for name, text in texts.items()
        if "<article" in text
        for found in re.findall(r".{0,20}(?:[‖∂√⊗∫ᵀκλτθιεψ]|\w\^\w).{0,20}", prose(text))
    ]
    typeset = sum(text.count('class="math notranslate') for text in texts.values())
    assert typeset > 3000
    assert len(left) <= typeset / 150, left
    mathematics = (DOCS / "mathematics.md").read_text("utf-8")
    assert (
        re.findall(r"\$[^$]*\\[,;!{}][^$]*\$", re.sub(r"```.*?```", "", mathematics, flags=re.DOTALL)) == []
    )  # GitHub


@pytest.mark.parametrize(
    ("text", "typeset"),
    [
        ("κ > (ι²/ε + ι)/λ2 holds", r"$κ>(ι^{2}/ε+ι)/λ_{2}$ holds"),
        ("‖x^i − x*‖ falls like e^{−r s}.", r"$\lVert x^{i}-x^{\ast }\rVert$ falls like $e^{-r\,s}$."),
        ("N players for 1.2 s, T = 1.2 s", r"$N$ players for 1.2 s, $T=1.2$ s"),
        ("on [0, ∞) and at T. The", r"on $[0,\;\infty )$ and at $T$. The"),
        ("while ρ((z − 1)(z I − A)^{−1} G) < 1, a rate", r"while $ρ((z-1)(z\,I-A)^{-1}\,G)<1$, a rate"),
        ("| \\|x\\| | a player |", r"| $\lvert x\rvert$ | a player |"),
        ("Z. Feng and G. Hu, n/a, a law, 5-cycle, point 5c", None),
        ("`x^i` and [κ](k_1.md) and $x^i$", "`x^i` and [$κ$](k_1.md) and $x^i$"),
    ],
)
def test_formulas_are_recognised_in_prose(formulas, text, typeset):
    assert formulas.typeset_markdown(text) == (text if typeset is None else typeset)


@pytest.mark.parametrize(
    ("tex", "shown"),
    [
        (r"x \text{ for all } i", "x<mtext>\u00a0for\u00a0all\u00a0</mtext>i"),
        (r"T \tanh s", "T<mspace/>tanh\u2061<mspace/>s"),
        (r"\cosh^2 s / \ln 10", "cosh2<mspace/>s/ln\u2061<mspace/>10"),
        (r"\tanh(s)", "tanh\u2061(s)"),
    ],
)
def test_formulas_keep_the_spaces_of_words_and_functions(formulas, tex, shown):
    elements, _ = formulas.mathml(tex, block=False)
    kept = re.sub(r"<mspace[^>]*>", "<mspace/>", re.sub(r"</?(?!mspace|mtext|/mtext)[^>]*>", "", elements))
    assert kept == shown


def test_no_line_begins_with_the_comma_after_a_formula(texts):
    formulas_of = re.compile(r'<span class="math[^>]*>(?:(?!</span>).)*</span>(.)', re.DOTALL)
    assert [found for found in formulas_of.findall(texts["docs/protocol"]) if found in ",.;:)"] == []


def test_excerpts_show_formulas_as_they_were_written(formulas):
    assert formulas.plain(r"\lVert x^{i}-x_{\mathrm{end}}\rVert \le e^{-r\,s}") == "‖x^i−x_end‖≤e^−r s"
    assert formulas.plain(r"g=c+\frac{1}{\lambda'(\lambda^{-1}(t))}") == "g=c+1/λ'(λ^−1(t))"


TOO_WIDE = """() => {
    const article = document.querySelector("article").getBoundingClientRect()
    return [...document.querySelectorAll("article *")].filter(element => {
        if (element.parentElement.closest(".table-wrapper, pre, math, svg") || element.closest("defs")) return false
        const isScroller = getComputedStyle(element).overflowX !== "visible" && !element.matches(".table-wrapper, pre")
        const limit = element.matches("math, img") ? article.right + 1 : innerWidth
        if (isScroller && element.scrollWidth > element.clientWidth + 1) return true
        return element.getBoundingClientRect().right > limit
    }).map(element => `${element.tagName} ${element.className} ${element.textContent.trim().slice(0, 60)}`)
}"""
"""Elements beyond the right edge of the page or of its text, and those that scroll; tables and code may scroll."""


# A page takes about a second in the browser, and only the browser knows its layout.
@pytest.mark.parametrize(
    ("width", "scheme", "quarter"),
    [(390, "light", 0), (390, "dark", 1), (390, "light", 2), (390, "dark", 3), (1440, "light", 0)],
)
def test_no_page_is_wider_than_the_screen(open_file, site, texts, width, scheme, quarter):
    names = sorted(name for name, text in texts.items() if "<article" in text)[quarter::4]
    assert len(names) >= 12
    page = open_file(site / f"{names[0]}.html", width, scheme)
    for name in names:
        page.goto((site / f"{name}.html").as_uri())
        assert page.evaluate("document.documentElement.scrollWidth") <= width, name
        assert page.evaluate(TOO_WIDE) == [], name


def test_pages_print_no_labels_and_commands_of_latex(texts):
    """MathML has no LaTeX, and numbers of equations are those that the paper prints."""
    for name, text in texts.items():
        article = text[text.find("<article") : text.find("</article>")]
        for code in ("pre", "code", "svg", "dt"):
            article = re.sub(rf"<{code}\b.*?</{code}>", " ", article, flags=re.DOTALL)
        words = html.unescape(re.sub(r"<[^>]+>", " ", article))
        assert re.findall(r".{20}(?:\b(?:eq|thm|fig|sec|lem|prop|tab):\w|\\[a-zA-Z]{2,}|[_^]\{).{20}", words) == [], (
            name
        )


def test_search_shows_excerpts_without_a_server(open_file, site):
    page = open_file(site / "search.html")
    page.goto(f"{(site / 'search.html').as_uri()}?q=prescribed+gain")
    excerpts = page.locator("#search-results p.context")
    excerpts.nth(4).wait_for()  # results come one after the other
    texts = excerpts.all_inner_texts()
    assert sum("gain" in text.lower() for text in texts) >= len(texts) / 2
    assert "floatfloat" not in (site / "_static" / "texts.js").read_text("utf-8")  # each type by one name


def test_every_scenario_has_a_page_with_costs_picture_and_numbers(texts):
    pages = {name: texts[f"docs/scenarios/{name}"] for name in CATALOGUE}
    for name, text in pages.items():
        assert text.count("--width: ") == 3, name
        sentence = html.escape(DESCRIPTIONS[name], quote=False).replace("'", "\N{RIGHT SINGLE QUOTATION MARK}")
        assert f"<p>{sentence}</p>" in text, name
        assert 'class="math notranslate' in text, name
        words = " ".join(html.unescape(re.sub(r"<[^>]+>", "", text)).split())
        assert f"Printed by ptne certify {name};" in words
        assert f"by ptne compare --scenario {name} --policy " in words


def test_numbers_of_a_scenario_page_are_those_of_its_commands(texts, tmp_path):
    page = html.unescape(re.sub(r"<[^>]+>", " ", texts["docs/scenarios/oligopoly"]))
    (command,) = re.findall(r"ptne (compare --scenario oligopoly \S+ \S+ --episodes \d+)", " ".join(page.split()))
    out = tmp_path / "out"
    run_python("-m", "ptne_env.cli", *command.split(), "--no-report", "--out", out, folder=tmp_path, modules=[ROOT])
    records = json.loads((out / "results.json").read_text("utf-8"))["records"]
    digits = [f"{record['mean']:.3g}" for record in records if record["metric"] == "digits"]
    assert len(digits) >= 4
    assert [number for number in digits if number not in page.replace("−", "-")] == []


def test_landing_page_has_the_install_line_and_the_first_code_of_the_readme():
    readme, index = ((ROOT / name).read_text("utf-8") for name in ("README.md", "docs/index.md"))
    first = re.search(r"```python\n.*?```", readme, re.DOTALL)[0]
    assert first in index
    assert index.index("pip install") < index.index(first) < index.index("![")
