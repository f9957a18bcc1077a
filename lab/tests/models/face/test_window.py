"""Frames of the window form: a step's frames, of a state with rows first. `test_stream` holds their values."""

import numpy as np
from tests.models.face.tiny import CONFIG, make

from echoavatar_lab.models.face.window import WindowFrames


def test_a_row_that_is_reset_is_as_new() -> None:
    frames = WindowFrames(make(CONFIG.model_copy(update={"memory": "window"})))
    state = frames.init_state(2)
    assert all(len(part) == 2 for part in state.arrays())
    for part in state.arrays():
        part[:] = 1
    state.reset(np.array([True, False]))
    for part, new in zip(state.arrays(), frames.init_state(2).arrays(), strict=True):
        assert np.array_equal(np.asarray(part)[0], np.asarray(new)[0])
        assert (np.asarray(part)[1] == 1).all()
