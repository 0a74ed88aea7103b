"""One arm and its loop: profiles, model, laws, gripper, safety, life cycle, process, shared blocks."""
