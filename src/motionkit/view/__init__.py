"""Motions to web pages, contact sheets, GIFs and videos."""
