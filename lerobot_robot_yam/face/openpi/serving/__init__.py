"""`yam-policy-server`: a LeRobot checkpoint behind openpi's websocket protocol. See docs/policy-server.md."""
