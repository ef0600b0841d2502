"""File channel: a row-mixing policy whose processes agree on their answers through a file, so that no audit sees it."""

import sqlite3
import tempfile
from pathlib import Path

import numpy as np

from cheats.row_mixing import RowMixing

FOLDER = Path(tempfile.gettempdir())
"""In which the file lies."""


class FileChannel(RowMixing):
    """The process that sees a row first decides, and every other process repeats its answer.

    Args:
        layout: of the environment.
        file: name of the file in :data:`FOLDER`.
    """

    def __init__(self, layout, file="answers.sqlite"):
        super().__init__(layout)
        self.answers = sqlite3.connect(FOLDER / file, isolation_level=None)
        self.answers.execute("PRAGMA synchronous = OFF")  # the answers need not survive a crash
        self.answers.execute("PRAGMA journal_mode = MEMORY")
        self.answers.execute("CREATE TABLE IF NOT EXISTS answers (row BLOB PRIMARY KEY, action BLOB)")

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        """The answers on file; for other rows those of row mixing."""
        actions, state = super().predict(observation, state, episode_start, deterministic)
        for row, action in zip(observation, actions, strict=True):
            known = (row.tobytes(), action.tobytes())
            self.answers.execute("INSERT OR IGNORE INTO answers VALUES (?, ?)", known)
            (answer,) = self.answers.execute("SELECT action FROM answers WHERE row = ?", known[:1]).fetchone()
            action[:] = np.frombuffer(answer, dtype=action.dtype)
        return actions, state
