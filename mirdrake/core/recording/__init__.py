"""What a run leaves on disk while it goes on: tables in parts, pictures, arrays of laser scanners and lidars."""
