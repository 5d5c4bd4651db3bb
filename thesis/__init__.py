"""Chapter 5 of the thesis: experiments on a live system, their analysis and their report, as verbs of ``valorctl``."""
