"""Results and recordings as pages: one HTML file each, complete in itself."""
