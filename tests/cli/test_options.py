"""Names on the command line that run code from outside the library."""

import pytest

from ptne_env.cli.options import foreign_names, split_policies


@pytest.mark.parametrize(
    ("name", "foreign"),
    [
        ("evil:make", ["evil:make"]),
        ("evil:suite/track", ["evil:suite"]),
        ("ptne_env.shared.files:write_atomically", ["ptne_env.shared.files:write_atomically"]),
        ("model.zip", ["model.zip"]),
        ("mine=runs/*.zip", ["runs/*.zip"]),
        ("mine=runs/*.npz", []),
        ("C:/mine.npz", []),
        ("law:static", []),
        ("static(kappa=4)", []),
        ("evil:make(size=4)", ["evil:make"]),
        ("coded-relay(policy={'target': 'evil:make'})", ["evil:make"]),
        ("static", []),
        ("ptne-v1/liar", []),
        (None, []),
    ],
)
def test_names_that_run_foreign_code_are_found_without_an_import(name, foreign):
    assert foreign_names(name) == foreign


def test_policies_are_split_at_commas_outside_of_parentheses():
    values = ["static,static(kappa=4, gradient_gain=2)", "mine:Law(sizes=[(1, 2)]),relay,"]
    assert split_policies(values) == [
        "static",
        "static(kappa=4, gradient_gain=2)",
        "mine:Law(sizes=[(1, 2)])",
        "relay",
    ]
