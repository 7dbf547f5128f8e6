/* place.h -- a place in a face of a cell, its two tangential coordinates: in single precision of 16 bits each. */
#ifdef DOUBLE
typedef REAL2 Place;

REAL2 coordinates(const Place place) { return place; }

Place place_at(const REAL2 x) { return x; }
#else
typedef ushort2 Place;

REAL2 coordinates(const Place place) { return convert_REAL2(place) / 65536; }

Place place_at(const REAL2 x) { return convert_ushort2_sat_rte(65536 * x); }
#endif
