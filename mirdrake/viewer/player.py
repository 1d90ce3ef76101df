"""The play bar of a recording: play and pause, a time line, the speed of the replay, and what the vehicle does."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass

from mirdrake.viewer.pages import add_to_body

_PANEL = """
<style>
  #player { position: fixed; left: 50%; bottom: 12px; transform: translateX(-50%); z-index: 3; display: flex; gap: 12px;
    align-items: center; width: min(860px, calc(100vw - 24px)); box-sizing: border-box; padding: 8px 14px;
    color: #1d2733; font: 14px/1.2 system-ui, sans-serif; font-variant-numeric: tabular-nums; border-radius: 8px;
    background: rgba(255, 255, 255, .93); box-shadow: 0 1px 6px rgba(0, 0, 0, .3); }
  #player button { width: 34px; height: 30px; border: 0; border-radius: 6px; background: #1d2733; color: #fff;
    cursor: pointer; }
  #player input { flex: 1; min-width: 60px; accent-color: #1f6feb; }
  #player select { font: inherit; padding: 3px; border: 1px solid #d5dbe3; border-radius: 6px; background: #fff; }
  #player span { white-space: nowrap; }
  @media (max-width: 480px) {
    #player { gap: 8px; padding: 6px 8px; font-size: 12px; }
    #player input { min-width: 40px; }
  }
  @media (max-width: 400px) { #player select { display: none; } }
</style>
<div id="player"><button title="play, pause: space"></button><span title="simulated time"></span>
  <input type="range" min="0" step="any" aria-label="time" title="time; the arrow keys move by 1 s">
  <select title="speed of the replay" aria-label="speed of the replay"></select><span></span></div>
<script>
(() => {
  const motion = MOTION, animator = viewer.animator, panel = document.getElementById("player");
  const [clock, gauge] = panel.querySelectorAll("span");
  const [play, line, pace] = panel.querySelectorAll("button, input, select");
  for (const rate of [0.1, 0.25, 0.5, 1, 2, 4, 8]) pace.add(new Option(`${rate} ×`, rate, rate === 1, rate === 1));
  const now = () => Math.max(0, ...animator.actions.map(action => action.time));
  function seek(time) {
    // The very end would begin the next repetition.
    animator.seek(Math.min(Math.max(time, 0), animator.duration - 1e-3));
  }
  const toggle = () => animator.playing ? animator.pause() : animator.play();
  play.onclick = () => { toggle(); play.blur(); };
  line.oninput = () => { animator.pause(); seek(Number(line.value)); };
  pace.onchange = () => { animator.mixer.timeScale = Number(pace.value); pace.blur(); };
  addEventListener("keydown", event => {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.code];
    if (event.code === "Space") toggle();
    else if (step) seek(now() + step);
    else return;
    event.preventDefault();
  });
  const side = angle => Math.abs(angle) < 0.05 ? "" : angle > 0 ? " left" : " right";
  function follow() {
    const time = now(), sample = Math.min(Math.round(time / motion.period), motion.speed.length - 1);
    play.textContent = animator.playing ? "❚❚" : "▶";
    line.max = animator.duration;
    if (document.activeElement !== line || animator.playing) line.value = time;
    clock.textContent = `${(motion.start + time).toFixed(1)} / ${(motion.start + animator.duration).toFixed(1)} s`;
    const angle = motion.steering[sample];
    gauge.textContent = `${motion.speed[sample].toFixed(1)} m/s · ${Math.abs(angle).toFixed(1)}°${side(angle)}`;
    requestAnimationFrame(follow);
  }
  requestAnimationFrame(follow);
})();
</script>
"""


@dataclass(frozen=True)
class Motion:
    """What the play bar states of a vehicle, in equal steps of time.

    Attributes:
        start: time of the first value [s].
        period: time between values [s].
        speed: longitudinal speed [m/s].
        steering: steering angle [deg], positive to the left.
    """

    start: float
    period: float
    speed: Sequence[float]
    steering: Sequence[float]


def with_player(page: str, motion: Motion) -> str:
    """Return a page of Meshcat that has an animation with a play bar.

    Args:
        page: HTML page of :meth:`pydrake.geometry.Meshcat.StaticHtml`.
        motion: at least one value of each.
    """
    return add_to_body(page, _PANEL.replace("MOTION", json.dumps(asdict(motion))))
