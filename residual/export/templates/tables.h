/* Correction of a torque by tables, of the arm '@NAME@', written by modelgap: one
   header, C99, no allocation.

   @P@_correction(x, out);

   x, in rad, rad/s, rad/s^2, of tau in N m, by number:
     @X@.
   out, in N m, to be added to the torque of the model that was calibrated:
     @OUT@.
   A value outside the calibrated range takes the nearest level. */
#ifndef @GUARD@
#define @GUARD@

@LEVEL@

static inline void @P@_correction(const double *x, double *out)
{
@BODY@
}

#endif
