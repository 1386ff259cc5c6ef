"""Types, paths and wishes in, the controls of every frame out; and whole motions made with them."""
