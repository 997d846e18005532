"""Import of radiometric files: one module for each maker of cameras, behind one protocol."""
