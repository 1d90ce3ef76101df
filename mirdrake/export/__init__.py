"""Export of a run: MCAP for Foxglove, CSV for spreadsheets, MP4 of the cameras."""
