"""Mathematics without a subject: geometry, spherical harmonics, Adam, planes of numbers."""
