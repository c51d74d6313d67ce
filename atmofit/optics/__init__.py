"""What the air is made of, and what it does to light at each wavelength."""
