"""Scripted misbehaviour: the language of fault scenarios, and who carries them out."""
