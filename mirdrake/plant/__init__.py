"""The MultibodyPlant: vehicles and world in contact, rest pose, suspension and powertrain."""
