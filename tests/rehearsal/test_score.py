import dataclasses

import pytest

from echoavatar.rehearsal.score import Note


def test_a_note_cannot_be_changed_after_it_was_written():
    note = Note(0.0, 1.0, 60, 0.5, "piano")
    with pytest.raises(dataclasses.FrozenInstanceError):
        note.pitch = 61
