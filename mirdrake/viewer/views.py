"""The views of all pages (follow, cockpit, map) as cameras relative to a vehicle.

Meshcat's camera looks at a fixed point, so the world is moved under it until the vehicle is at the origin and heads
along x (:func:`mirdrake.viewer.meshcat.chase`). A view is then a place of the camera, and the same for a drive, for a
recording and for a saved page. In a page the views are buttons, and the keys 1, 2 and 3.
"""

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass

from pydrake.geometry import Meshcat

from mirdrake.vehicles import Vehicle
from mirdrake.viewer.pages import add_to_body

CAR = 2.6
"""Wheelbase of the distances below [m]; they scale with the wheelbase of a vehicle."""

FOLLOW, COCKPIT, MAP = "follow", "cockpit", "map"
"""Names of the views."""

_PANEL = """
<style>
  #views { position: fixed; left: 12px; top: 12px; z-index: 3; display: flex; /* Meshcat has its own on the right */
    font: 14px/1.2 system-ui, sans-serif; border-radius: 8px; overflow: hidden; box-shadow: 0 1px 6px rgba(0,0,0,.3); }
  #views button { border: 0; padding: 8px 16px; background: #fff; color: #1d2733; cursor: pointer; font: inherit; }
  #views button + button { border-left: 1px solid #d5dbe3; }
  #views button.on { background: #1d2733; color: #fff; }
</style>
<div id="views"></div>
<script>
(() => {
  const views = VIEWS;
  const panel = document.getElementById("views");
  const buttons = views.map((view, number) => {
    const button = document.createElement("button");
    button.textContent = view.name[0].toUpperCase() + view.name.slice(1);
    button.title = `key ${number + 1}`;
    button.onclick = () => { look(number); button.blur(); };
    panel.append(button);
    return button;
  });
  function look(number) {
    // Meshcat's scene has its y axis upwards.
    const [eye, target] = [views[number].eye, views[number].target].map(([x, y, z]) => [x, z, -y]);
    viewer.handle_command({ type: "set_transform", path: "/Cameras/default",
      matrix: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1] });
    viewer.handle_command({ type: "set_target", value: target });
    viewer.handle_command({ type: "set_property", path: "/Cameras/default/rotated/<object>", property: "position",
      value: eye });
    viewer.set_dirty();
    buttons.forEach((button, index) => button.classList.toggle("on", index === number));
    document.body.dataset.view = views[number].name;
  }
  window.look = look;
  addEventListener("keydown", event => {
    const number = ["Digit1", "Digit2", "Digit3"].indexOf(event.code);
    if (number >= 0 && number < views.length && !event.ctrlKey && !event.altKey && !event.metaKey) look(number);
  });
})();
</script>
"""


@dataclass(frozen=True)
class View:
    """A camera relative to a vehicle at the origin that heads along x.

    Attributes:
        name: name of the view.
        eye: place of the camera [m]; x ahead of the rear axle, y to the left, z up.
        target: the point it looks at [m].
        lag: time constant with which the camera turns after the vehicle [s].
    """

    name: str
    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    lag: float


def make_views(vehicle: Vehicle) -> tuple[View, ...]:
    """Return the views of a vehicle, the default first.

    Args:
        vehicle: vehicle in the view; distances are multiples of its wheelbase.
    """
    size = vehicle.geometry.wheelbase / CAR
    return (
        View(FOLLOW, _scaled(size, -6.6, 0.0, 3.1), _scaled(size, 3.4, 0.0, 0.7), lag=0.35),
        # Above the windscreen: the bodies have no interior, and the bonnet shows where the vehicle heads.
        View(COCKPIT, _scaled(size, 2.3, 0.0, 1.5), _scaled(size, 10.0, 0.0, 0.9), lag=0.0),
        View(MAP, _scaled(size, 5.98, 0.0, 34.0), _scaled(size, 6.0, 0.0, 0.0), lag=0.6),
    )


def set_view(meshcat: Meshcat, view: View) -> None:
    """Move the camera of all browsers to a view."""
    meshcat.SetCameraPose(view.eye, view.target)


class ViewButtons:
    """Buttons for the views in Meshcat's own controls; the keys 1, 2 and 3 press them.

    Args:
        meshcat: where.
        views: views to choose from.
    """

    def __init__(self, meshcat: Meshcat, views: Iterable[View]) -> None:
        self._meshcat = meshcat
        self._views = {view.name.capitalize(): view for view in views}
        self._clicks = dict.fromkeys(self._views, 0)
        for number, name in enumerate(self._views, start=1):
            meshcat.AddButton(name, f"Digit{number}")

    def follow(self) -> str | None:
        """Return the name of the view that was selected since the last call, or None."""
        selected = None
        for name, view in self._views.items():
            clicks = self._meshcat.GetButtonClicks(name)
            if clicks != self._clicks[name]:
                self._clicks[name] = clicks
                set_view(self._meshcat, view)
                selected = view.name
        return selected


def with_views(page: str, views: Iterable[View]) -> str:
    """Return a page of Meshcat with buttons for views.

    Args:
        page: HTML page of :meth:`pydrake.geometry.Meshcat.StaticHtml`, or of a server.
        views: views to choose from.
    """
    data = json.dumps([asdict(view) for view in views]).replace("</", "<\\/")
    return add_to_body(page, _PANEL.replace("VIEWS", data))


def _scaled(size: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    return (round(size * x, 4), round(size * y, 4), round(size * z, 4))
