"""Actors: props that move on lanes and paths, see :mod:`mirdrake.worlds.actors_spec`.

::

    World.actors ── make_crew ──► Crew, LaneTable                  crew.py, lanes.py
    states at t ── step ──► states at t + 20 ms                    step.py (compiled)
        triggers and actions of scenarios                          triggers.py
        objects on lanes, the next one ahead and behind            occupancy.py
        right of way in junctions                              reservations.py
        acceleration by the law of a behaviour                     laws.py, behaviours/
        pose on a lane                                             motion.py
        pedestrians                                                walkers.py
    Traffic: all of them as a system                               traffic.py

A new behaviour is one file in ``behaviours/`` with its schema and its law, one line in
:data:`mirdrake.worlds.actors_spec.BEHAVIOURS`, and a branch in :mod:`mirdrake.actors.laws`.
"""
