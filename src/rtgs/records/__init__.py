"""The records that stages hand on: camera, Gaussians, radiometry, scene."""
