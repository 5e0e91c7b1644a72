"""Collects views: from photos and videos, or live with hints."""
