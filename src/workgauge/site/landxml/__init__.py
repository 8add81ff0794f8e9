"""The reader of LandXML and Inframodel files, by local element name whatever the namespace."""
