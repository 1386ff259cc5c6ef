"""What the network drew, or any clip, becomes the motion that is written: root height, the root's path, feet."""
