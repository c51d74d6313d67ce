"""Light through things that are not the whole sky: air along a path, fog, layers, clouds."""
