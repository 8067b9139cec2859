"""The hot wire: shapes of the elastic wire, its fitting, its stability and its data."""
