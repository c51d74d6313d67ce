"""What was measured of skies: observations, the files that they come from, photographs."""
