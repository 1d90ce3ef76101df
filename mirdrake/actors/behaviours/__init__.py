"""Behaviours of actors: one file each, registered in :data:`mirdrake.worlds.actors_spec.BEHAVIOURS`."""
