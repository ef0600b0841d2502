import pytest

from ptne_env.shared.names import unknown_name

KNOWN = ["static", "static-tuned", "grounded", "ptne-v1/delay", "ptne-v1/large-20"]


@pytest.mark.parametrize(
    ("asked", "suggested"),
    [
        ("statik", "'static'"),
        ("STATIC", "'static' or 'static-tuned'"),
        ("static_tuned", "'static-tuned' or 'static'"),
        ("groundd", "'grounded'"),
        ("delay", "'ptne-v1/delay'"),
        ("ptne-v1/dleay", "'ptne-v1/delay' or 'ptne-v1/large-20'"),
        ("gr", "'grounded'"),
    ],
)
def test_similar_names_are_suggested_the_nearest_first(asked, suggested):
    assert unknown_name("policy", asked, KNOWN) == f"unknown policy {asked!r}; did you mean {suggested}?"


def test_without_a_similar_name_all_names_are_listed():
    assert (
        unknown_name("policy", "xyz", KNOWN[:3]) == "unknown policy 'xyz'; choose from static, static-tuned, grounded"
    )
    message = unknown_name("policy", "xyz", KNOWN[:1], "an .npz file")
    assert message == "unknown policy 'xyz'; choose from static, or an .npz file"


def test_at_most_three_names_are_suggested():
    assert sum(name in unknown_name("law", "a", ["ab", "ac", "ad", "ae"]) for name in ("ab", "ac", "ad", "ae")) == 3
