"""Files of a run in progress: tables in parts, pictures, arrays of laser scanners and lidars."""
