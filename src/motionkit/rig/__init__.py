"""Any rig in any unit and axis, there and back: names, shape, rest pose, map, unit, up axis, retargeting, GLB, VRM."""
