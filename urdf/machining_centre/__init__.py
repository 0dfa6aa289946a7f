"""The machining centres: platform, limb, and the clamps under the feet."""
