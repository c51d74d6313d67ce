"""Pictures: sky domes, and what a refit looks like. Matplotlib is imported where it is used."""
