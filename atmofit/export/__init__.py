"""Sky models as source code for renderers."""
