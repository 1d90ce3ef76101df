"""The cockpit of a manual drive in real time: keys, game pad and sliders, a picture in Meshcat, recordings.

::

    page.html, page.css, page.js   the page, in front of Meshcat's own page
    open        simulation, server and page together
    server      the page, its messages and requests, Meshcat behind the same port
    watchdog    which page drives, and the timeout of its input
    manual      keys, game pad and sliders to a command
    driver      the command as a system of the diagram
    start       the diagram, and the limits of manual driving
    drive       the loop: input, a time slice, a picture
    gains       gains as parameters of the Context
    picture     the vehicle and its world in Meshcat, from its views
    overlays    driven path, points, forces; made of ribbons and arrows (shapes)
    log         the recording
"""

from mirdrake.viewer.cockpit.drive import Cockpit
from mirdrake.viewer.cockpit.open import OpenCockpit
from mirdrake.viewer.cockpit.start import drive_spec

__all__ = ["Cockpit", "OpenCockpit", "drive_spec"]
