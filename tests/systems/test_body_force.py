"""BodyForce: a body on a plane of no friction moves as Newton says."""

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from systems.body_force import BodyForce


def test_newton():
    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(0.001))
    body = plant.AddRigidBody("ball", SpatialInertia.SolidSphereWithMass(2.0, 0.1))
    plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    plant.Finalize()
    force = builder.AddSystem(BodyForce(body.index(), [0.0, 0.0, 0.0]))
    source = builder.AddSystem(ConstantVectorSource([4.0, 0.0, -2.0]))
    builder.Connect(source.get_output_port(), force.get_input_port())
    builder.Connect(force.get_output_port(), plant.get_applied_spatial_force_input_port())
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(0.5)
    context = plant.GetMyContextFromRoot(simulator.get_context())
    velocity = plant.EvalBodySpatialVelocityInWorld(context, body).translational()
    assert np.allclose(velocity, [1.0, 0.0, -0.5], atol=1e-9)  # F t / m
    torque = plant.EvalBodySpatialVelocityInWorld(context, body).rotational()
    assert np.allclose(torque, 0.0, atol=1e-12)
