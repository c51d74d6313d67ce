"""From an atmosphere to the radiance of its sky."""
