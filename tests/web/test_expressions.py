"""`expressions.json` holds outputs of Python's map from ARKit to VRM; the client's tests compare its map with them."""

import json
from pathlib import Path

import numpy as np

from echoavatar.motion.arkit import ARKIT_NAMES, to_vrm


def test_the_file_that_the_client_is_held_to_is_what_we_do():
    told = json.loads(Path(__file__).with_name("expressions.json").read_text())
    assert told["names"] == list(ARKIT_NAMES)
    np.testing.assert_allclose(to_vrm(np.array(told["curves"], np.float32)), told["vrm"], atol=1e-4)
