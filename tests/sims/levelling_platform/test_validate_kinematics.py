"""The kinematic model beside the multibody plant."""


def test_model_and_plant_agree_as_drawn_and_differ_as_built(finished):
    found = finished("validate-kinematics").values
    for axis, bound in (("roll_error_deg", 0.02), ("pitch_error_deg", 0.02)):
        assert found[axis] < bound
    assert found["height_error_mm"] < 0.1
    worse = [
        found[f"perturbed_{key}"] / found[key]
        for key in ("roll_error_deg", "pitch_error_deg", "height_error_mm")
    ]
    assert max(worse) > 5.0
