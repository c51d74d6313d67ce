"""Constants, each with its unit and source; those of the 1999 paper are in `tables`."""

EARTH_RADIUS = 6371e3  # [m], mean radius (IUGG)
REFERENCE_WAVELENGTH_NM = 550.0  # haze optical depth and turbidity are given here

# Of the simulator: below, oxygen absorbs the sun's light; beyond, the air's own heat shines.
MINIMUM_WAVELENGTH_NM = 200.0
MAXIMUM_WAVELENGTH_NM = 3000.0

LARGEST_OPTICAL_DEPTH = 1e3  # vertical, of one constituent
LARGEST_SCALE_HEIGHT = 3e4  # [m]
SMALLEST_SCALE_HEIGHT = 1.0  # [m]
MINIMUM_TURBIDITY, MAXIMUM_TURBIDITY = 1.0, 64.0  # pure air to fog, the range of the paper's Fig. 3
