import json
import math
from dataclasses import replace

import numpy as np
import pytest

from liftgate_hil.errors import ConfigError
from liftgate_hil.report.files import check_target


def strict(content):
    """Return a content after its conversion to JSON and back, in which NaN and infinity are refused."""
    return json.loads(json.dumps(content, allow_nan=False))


def test_json_results_have_the_public_keys(found):
    content = strict(found.to_dict())
    assert set(content) >= {
        "parameters", "covariance", "correlation", "noise_variance", "fit_percent", "loss", "fpe", "aic", "aicc",
        "bic", "condition_number", "stop_reason", "identifiable", "inseparable", "model", "vehicle",
        "initial_states", "iterations", "evaluations", "seconds", "profiles", "notes", "experiments",
        "parameter_names", "noise_outputs", "covariance_kind", "input_jitter",
    }  # fmt: skip
    resistance = content["parameters"]["motor.resistance"]
    assert resistance == {
        "value": 2.12797, "std": 0.0217914, "initial": 0.708, "unit": "ohm", "symbol": "R", "low": 0.1,
        "high": 10.0, "relative_error": pytest.approx(0.0217914 / 2.12797), "is_at_bound": False,
        "is_held": False, "remark": "", "identifiable": True,
    }  # fmt: skip
    assert content["identifiable"]["motor.inductance"] is False
    assert content["parameter_names"] == list(content["parameters"])
    assert np.shape(content["covariance"]) == (5, 5)
    assert content["noise_variance"][0][0] == 0.0491
    assert content["noise_outputs"][0] == "left_current_a"


def test_numbers_that_are_not_finite_are_null_in_json(found):
    content = strict(replace(found, loss=math.inf, aic=math.nan).to_dict())
    assert content["loss"] is None
    assert content["aic"] is None
    assert content["parameters"]["hinge.friction"]["std"] is None
    assert content["parameters"]["hinge.friction"]["high"] is None
    assert content["profiles"]["motor.inductance"]["low"] is None
    assert content["covariance"][4][4] is None


def test_a_fit_is_the_mean_over_experiments(found):
    content = strict(found.to_dict())
    each = [one["fit_percent"]["left_speed_rps"] for one in content["experiments"]]
    assert len(each) == 2
    assert content["fit_percent"]["left_speed_rps"] == pytest.approx(sum(each) / 2)
    assert content["fit_percent_initial"]["left_speed_rps"] < 71.0


def test_a_fit_that_is_not_defined_does_not_spoil_the_mean(judged):
    one, other = judged.experiments
    still = replace(one, series=(replace(one.series[0], fit_percent=math.nan), *one.series[1:]))
    content = strict(replace(judged, experiments=(still, other)).to_dict())
    assert content["fit_percent"]["left_current_a"] == other.series[0].fit_percent
    assert content["experiments"][0]["fit_percent"]["left_current_a"] is None


def test_a_validation_pools_errors_by_samples(judged):
    content = strict(judged.to_dict())
    assert set(content) >= {"fit_percent", "rms", "maximum", "phases", "whiteness", "experiments"}
    rows = [each.series[1] for each in judged.experiments]
    error = np.concatenate([each.measured - each.simulated for each in rows])
    assert content["rms"]["left_speed_rps"] == pytest.approx(np.sqrt(np.mean(error**2)))
    assert content["maximum"]["left_speed_rps"] == pytest.approx(np.max(np.abs(error)))
    assert content["phases"]["left_speed_rps"]["start"]["samples"] == 1334
    assert content["whiteness"] == {
        "left_current_a": True, "left_speed_rps": True, "left_position_rev": False, "gate_angle_deg": False,
    }  # fmt: skip


def test_hostile_names_give_valid_json(hostile):
    assert strict(hostile.to_dict())["vehicle"] == hostile.vehicle


@pytest.mark.parametrize("name", ["", "missing/result.json", ".", "a\0b", "x" * 5000])
def test_the_check_of_a_result_path_refuses_one_that_cannot_be_written(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=r"^`result` "):
        check_target(name, "result")


def test_checking_a_result_path_creates_no_file_and_refuses_a_folder_without_permission(tmp_path, monkeypatch):
    check_target(str(tmp_path / "result.json"), "result")
    assert not list(tmp_path.iterdir())
    monkeypatch.setattr("os.access", lambda *_: False)
    with pytest.raises(ConfigError, match=r"`html` .*no permission to write folder"):
        check_target(str(tmp_path / "a.html"), "html")


def test_an_unknown_largest_error_is_null_in_any_order_of_experiments(judged):
    one, other = judged.experiments
    lost = replace(one, series=(replace(one.series[0], maximum=math.nan), *one.series[1:]))
    for order in ((lost, other), (other, lost)):
        content = strict(replace(judged, experiments=order).to_dict())
        assert content["maximum"]["left_current_a"] is None
