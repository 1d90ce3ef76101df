"""A run in formats of other tools: MCAP for Foxglove, CSV for a spreadsheet, MP4 of the cameras."""
