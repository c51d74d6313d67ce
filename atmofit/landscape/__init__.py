"""A landscape of heights, to see air, sun and sky at work."""
