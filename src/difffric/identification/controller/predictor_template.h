/* mu_s of a push from its peak force and its free-sliding distance.

   Made by `difffric export`: change the set-up and export again, not this file. C99, double
   precision; no memory is allocated, nothing is written but the answer, nothing is linked.

   $statement
   Box: speeds $box_speeds m/s, mu_s $least_mu_s to $most_mu_s.
   Rig: $rig */
#ifndef DIFFFRIC_PREDICTOR_H
#define DIFFFRIC_PREDICTOR_H

/* Standard errors of the readings in the set-up [N, m]; 0: it does not say. */
#define DIFFFRIC_PEAK_FORCE_SE $peak_force_se
#define DIFFFRIC_SLIDING_DISTANCE_SE $sliding_distance_se

/* Largest relative error of mu_s, readings being exact. */
#define DIFFFRIC_MAX_ERROR $max_error

/* Which readings mu_s is from; also what difffric_predict returns. */
enum { DIFFFRIC_NEITHER = 0, DIFFFRIC_FORCE = 1, DIFFFRIC_DISTANCE = 2, DIFFFRIC_BOTH = 3 };

/* What became of a reading. */
enum {
    DIFFFRIC_DETERMINED = 0,
    DIFFFRIC_NOT_MEASURED = 1,   /* NaN */
    DIFFFRIC_SPEED_OUTSIDE = 2,  /* of the box */
    DIFFFRIC_NOT_DETERMINED = 3, /* hardly depends on mu_s there; several mu_s, or none, give it */
    DIFFFRIC_OUTSIDE_BOX = 4     /* mu_s is */
};

typedef struct {
    double mu_s;              /* from what status says; NaN where that is DIFFFRIC_NEITHER */
    double variance;          /* of mu_s, from the readings' standard errors; NaN: not known */
    double mu_s_force;        /* from F_p alone, NaN where it does not determine mu_s */
    double variance_force;
    double mu_s_distance;     /* from d alone, likewise */
    double variance_distance;
    int status;               /* DIFFFRIC_NEITHER, _FORCE, _DISTANCE or _BOTH */
    int force;                /* what became of F_p: DIFFFRIC_DETERMINED, or why not */
    int distance;             /* and of d */
} difffric_answer;

/* v [m/s], F_p [N], d [m]; NaN: not measured. F_p_se [N] and d_se [m] are their standard errors;
   an estimate without one (NaN, or not > 0) does not count in mu_s beside one with, and two without
   count alike. Returns answer->status. */
int difffric_predict(double v, double F_p, double d, double F_p_se, double d_se,
                     difffric_answer *answer);

#endif
