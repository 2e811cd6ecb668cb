"""The format of OpenMarkov, ProbModelXML (`.pgmx`): factored models with tables and trees, events and teams."""
