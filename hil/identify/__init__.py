"""Identification of an axis: experiments, fits of what they recorded, and the model that follows."""
