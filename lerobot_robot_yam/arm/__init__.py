"""An arm as it is, without input or output: configuration, profiles, model, kinematics, collisions."""
