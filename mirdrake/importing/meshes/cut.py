"""Decompose a closed surface into convex parts with CoACD, in a separate process: a script with arrays in and out.

CoACD can take minutes for a surface that intersects itself, and Python signals do not interrupt it.
"""

import io
import signal
import sys

import numpy as np

SECONDS = 20
"""Processor time after which the process ends."""


def settings(bodies: int) -> dict[str, str | int]:
    """Return the CoACD settings for a surface of a number of bodies; several bodies are merged first."""
    if bodies == 1:
        return {"preprocess_mode": "off", "mcts_nodes": 20, "mcts_iterations": 60, "mcts_max_depth": 3,
                "resolution": 1000}  # fmt: skip
    return {"preprocess_mode": "on", "preprocess_resolution": 20, "mcts_nodes": 10, "mcts_iterations": 20,
            "mcts_max_depth": 2, "resolution": 600}  # fmt: skip


def main() -> None:
    """Read points, faces, limit, concavity, bodies and seconds from stdin; write ``part_0``, ... to stdout."""
    given = np.load(io.BytesIO(sys.stdin.buffer.read()))
    if hasattr(signal, "setitimer"):  # ends it even if its caller was killed
        signal.setitimer(signal.ITIMER_REAL, float(given["seconds"]))
    try:
        import resource

        # A second guard: the kernel ends the process after its share of processor time.
        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
    except (ImportError, ValueError, OSError):
        pass  # there the caller's clock alone counts
    import coacd

    coacd.set_log_level("off")
    # CoACD draws random numbers; a fixed seed makes imports repeatable.
    solid = coacd.Mesh(given["points"], given["faces"].astype(np.int32))
    limit, concavity, how = int(given["limit"]), float(given["concavity"]), settings(int(given["bodies"]))
    parts = coacd.run_coacd(solid, threshold=concavity, max_convex_hull=limit, seed=0, **how)
    answer = io.BytesIO()
    arrays = {f"part_{number}": np.asarray(points) for number, (points, _) in enumerate(parts)}
    np.savez(answer, **arrays)  # type: ignore[arg-type]
    sys.stdout.buffer.write(answer.getvalue())


if __name__ == "__main__":
    main()
