"""What :func:`mirdrake.diagram.assemble` puts together.

Each module adds its part to a :class:`mirdrake.wiring.Wiring`: :mod:`.places` where vehicles start, :mod:`.forces` what
acts on the plant from outside, :mod:`.vehicles` control unit, driver and powertrain, :mod:`.sensors`, and :mod:`.taps`
what is logged.
"""
