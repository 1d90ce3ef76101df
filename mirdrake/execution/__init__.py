"""Run many independent jobs: worker processes, their journal and results, locally or on a cluster."""
