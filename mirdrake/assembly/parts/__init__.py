"""Parts that :func:`mirdrake.assembly.diagram.assemble` combines.

Each module adds its part to a :class:`mirdrake.assembly.wiring.Wiring`: :mod:`.places` the start poses of vehicles,
:mod:`.forces` external forces on the plant, :mod:`.vehicles` control unit, driver and powertrain, :mod:`.sensors` the
sensors, and :mod:`.taps` the logged signals; :mod:`.steps` states whether its events fall on steps of the plant.
"""
