"""Names on the command line that run code from outside the library."""

import pytest

from ptne_env.cli.options import foreign_names


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
        ("static", []),
        ("ptne-v1/liar", []),
        (None, []),
    ],
)
def test_names_that_run_foreign_code_are_found_without_an_import(name, foreign):
    assert foreign_names(name) == foreign
