"""What hold-outs keep, in a sentence where an all-clear would keep quiet about it."""

import pytest

from eps_hil.diagnosis.proof_of_fit import still_left


@pytest.mark.parametrize(("after", "said"), [(0.010, False), (0.0129, False), (0.0175, True)])
def test_clearly_more_than_noise_is_said(after: float, said: bool) -> None:
    told = {
        "augmented": {"torque_nrmse": after},
        "noise_floor": {"torque_nrmse": 0.010},
        "baseline": {"torque_nrmse": 0.2},
    }
    sentences = still_left(told)
    assert bool(sentences) is said
    if said:
        assert "1.8 times" in sentences[0]
