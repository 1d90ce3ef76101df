"""A drive in real time: hands at the wheel, Meshcat before the eyes, a run folder behind.

::

    page.html, page.css, page.js   what the browser shows, over Meshcat's own page
    open        all of it together
    server      the page, its reports and orders, Meshcat behind the same port
    dead_man    which page drives, and whether somebody still does
    hands       keys, pad and sliders to a command
    driver      that command as a system of the diagram
    start       the diagram, and the limits of hands
    drive       the loop: hands, a slice of time, a picture
    gains       gains as parameters of the Context
    picture     the vehicle and its world in Meshcat, from its views
    overlays    what can be laid over it, as ribbons and arrows of shapes
    log         what is recorded
"""

from mirdrake.viewer.cockpit.drive import Cockpit
from mirdrake.viewer.cockpit.open import OpenCockpit
from mirdrake.viewer.cockpit.start import drive_spec

__all__ = ["Cockpit", "OpenCockpit", "drive_spec"]
