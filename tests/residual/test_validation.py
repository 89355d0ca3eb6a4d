"""Both directions of a model, and models tried on logs they have not seen."""

from dataclasses import replace

import numpy as np
import pytest

from residual.errors import InputError
from residual.identification.identify import identify
from residual.model.compare import compute_model_errors, prepare_held_out
from residual.model.dynamics import compute_acceleration_error
from tests.residual.identified import logs, truth


@pytest.fixture(scope="module")
def identification():
    return identify(truth().robot, logs(noise=0.3))


@pytest.fixture(scope="module")
def held_out():
    return logs(1, noise=0.3, seed=7)


def test_the_identified_model_beats_the_nominal_both_ways(identification, held_out):
    models = {"nominal": identification.nominal, "identified": identification.model}
    nominal = identification.nominal
    torque, _ = compute_model_errors(models, prepare_held_out(held_out, nominal), nominal.filters)
    assert torque["identified"].overall("moving") < 3
    assert torque["identified"].overall("raw") < 0.2 * torque["nominal"].overall("raw")
    both = [compute_acceleration_error(m, held_out).overall("moving") for m in models.values()]
    assert both[1] < 10
    assert both[1] < 0.1 * both[0]


def test_a_joint_that_stands_has_no_acceleration_error(identification):
    error = compute_acceleration_error(identification.model, logs(1, joints=(0, 1)))
    assert np.isnan(error.per_joint("moving")[2])
    assert np.isfinite(error.overall("moving"))


BAD = {
    "impossible body": (
        lambda f: compute_acceleration_error(replace(f.model, inertial=-f.model.inertial), logs(1)),
        "expected more than 0: it has no acceleration",
    )
}


@pytest.mark.parametrize("what", BAD)
def test_what_cannot_be_validated_is_said(identification, what):
    call, message = BAD[what]
    with pytest.raises(InputError, match=message):
        call(identification)
