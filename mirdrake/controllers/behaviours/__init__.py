"""Behaviours: drivers that look at what is around them, and bad ones that do not.

::

    state ──┐
            ├─► Behaviour (every period) ─► command
    ranges ─┘

``outline`` measures a vehicle's box, ``fan`` knows the beams of its range scan, ``laws`` holds the arithmetic,
``base`` the common LeafSystem; one module a behaviour. ``spec`` has their entries in a file, and ``make`` turns such an
entry, or a class of the user's own, into a system.
"""
