"""SDF: elements, frames and the search for included models, shared by the importers of vehicles and of worlds."""
