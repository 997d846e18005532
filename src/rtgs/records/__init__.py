"""The records that stages hand on: camera, Gaussians, radiometry, rig, capture, scene, decision."""
