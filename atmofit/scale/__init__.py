"""Many skies on many devices and machines, in blocks that outlive a kill."""
