"""The diagram: its file format, blocks and wiring, made into a Drake Diagram and drawn."""
