"""Link frames and Jacobians, compiled, against pinocchio's."""

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from workgauge.machine.load import load_machine


@pytest.mark.parametrize("name", ["rre20", "brokk5"])
def test_they_are_pinocchios(name):
    machine = load_machine(name)
    model = machine.pinocchio_model()
    data = model.createData()
    rng = np.random.default_rng(3)
    for _ in range(50):
        q = machine.sample_min + rng.uniform(size=machine.n) * (machine.sample_max - machine.sample_min)
        kin = machine.forward(q)
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        assert_allclose(kin.spatial_jacobian, data.J, atol=1e-12)
        assert_allclose(kin.T_machine_links[0], np.eye(4), atol=0.0)
        for i, link in enumerate(machine.link_names[1:], start=1):
            frame = data.oMf[model.getFrameId(link)].homogeneous
            assert_allclose(kin.T_machine_links[i], frame, atol=1e-12)
