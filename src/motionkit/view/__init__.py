"""Motion in, something to look at out: pages, contact sheets, GIFs, films."""
