/* Torque of the arm '@NAME@', written by modelgap: one header, C99, no allocation.

   @P@_memory memory;
   @P@_start(&memory);
   @P@_torque(&memory, t, q, qd, qdd, tau);

   t is the time since the session began [s]; q, qd, qdd are [rad, rad/s, rad/s^2] and
   tau is [N m], @DOF@ numbers each, joint 1 first. Give the samples in order: friction
   that remembers its way and delays keep what they need in the memory.

   It has: @HAS@.
   It has not: @LEFT@. */
#ifndef @GUARD@
#define @GUARD@

#include <math.h>
@COMPLEX@
enum { @P@_dof = @DOF@ };

typedef struct { double number[@MEMORY@]; } @P@_memory;

static inline void @P@_start(@P@_memory *memory)
{
    for (int i = 0; i < @MEMORY@; i++) memory->number[i] = 0.0;
}
