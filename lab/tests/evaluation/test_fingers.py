import numpy as np
from lab.tests.models.fingers.moving import waving

from echoavatar.motion.kinematics.rotations import matrix_from_axis_angle
from echoavatar_lab.evaluation.fingers import compare, curl, fingertips, measure_fingers, speed_and_spread
from echoavatar_lab.models.fingers.clips import FINGERS, finger_clip
from echoavatar_lab.models.fingers.model import FingerModel


def fingers(seed: int = 0) -> np.ndarray:
    return waving(seed=seed).matrices()[:, list(FINGERS)]


def test_the_truth_scores_best_and_a_shift_is_an_error(model: FingerModel) -> None:
    truth = fingers()
    own = compare([truth], [truth], model.basis)
    assert own["error_deg"] < 0.05
    assert own["tip_error_cm"] == 0
    assert own["curl_correlation"] > 0.999
    assert abs(own["frechet"]) < 1e-3
    turned = truth @ matrix_from_axis_angle(np.array([0.1, 0.0, 0.0], np.float32))
    assert abs(compare([turned], [truth], model.basis)["error_deg"] - 5.73) < 0.01


def test_frozen_hands_have_no_liveliness() -> None:
    still = np.repeat(fingers()[:1], 50, axis=0)
    assert max(speed_and_spread([still]).values()) < 0.1
    assert speed_and_spread([fingers()])["speed_mean_deg_s"] > 10


def test_fingertips_of_flat_hands_point_outwards_and_a_fist_is_closed() -> None:
    flat = np.broadcast_to(np.eye(3, dtype=np.float32), (1, 30, 3, 3))
    tips = fingertips(flat)[0]
    assert (tips[:5, 0] > 0.05).all()
    assert (tips[5:, 0] < -0.05).all()
    np.testing.assert_allclose(tips[2], np.array([0.184, 0.004, 0.004]), atol=1e-5)
    assert curl(flat).max() == 0


def test_a_model_is_scored_beside_its_baselines(model: FingerModel) -> None:
    scores = measure_fingers(model, [finger_clip(waving(seed=50)), finger_clip(waving(still=("left",)))])
    assert set(scores) == {"model", "model, one step", "mean pose", "flat hands", "truth"}
    assert scores["model"]["error_deg"] < scores["mean pose"]["error_deg"] < scores["flat hands"]["error_deg"]
    assert scores["mean pose"]["curl_correlation"] == 0
    assert scores["model"]["frechet"] < scores["mean pose"]["frechet"]
