/* See predictor.h. Self-test, against golden.csv:
     cc -std=c99 -O2 -DDIFFFRIC_SELFTEST predictor.c -o selftest && ./selftest golden.csv */
#include "predictor.h"

#include <math.h> /* NAN alone: no function of it is called */

/* In a cell mu_s / v is a polynomial of q / v (q: F_p or d) and, across a range of speeds, of v:
   the sum of c[i][j] tau^i xi^j, with tau and xi from -1 to 1 over the cell. */
$tables

typedef struct {
    const double *speeds; /* ends of the ranges of speed */
    const int *first;     /* each range's first cell */
    int ranges;
    const double *lower; /* of q / v, rising within a range */
    const double *upper;
    const double *c;
    int tau, xi; /* numbers of coefficients */
} difffric_table;

static const difffric_table difffric_force = {
    force_speeds, force_first, $force_ranges, force_lower, force_upper, force_c, $force_tau, $force_xi
};
static const difffric_table difffric_distance = {
    distance_speeds, distance_first, $distance_ranges, distance_lower, distance_upper, distance_c,
    $distance_tau, $distance_xi
};

/* The last of n rising numbers, from the one at `low`, that is not above x; low - 1: none is. */
static int last_below(const double *a, int low, int high, double x)
{
    --low;
    while (high - low > 1) {
        const int middle = low + (high - low) / 2;
        if (a[middle] <= x)
            low = middle;
        else
            high = middle;
    }
    return low;
}

static int one(const difffric_table *t, double v, double q, double se, double *mu_s,
               double *variance)
{
    double X, y = 0.0, slope = 0.0, width, xi, tau;
    int range, cell, i, j;

    *mu_s = *variance = NAN;
    if (q != q)
        return DIFFFRIC_NOT_MEASURED;
    if (!(v >= $slowest && v <= $fastest))
        return DIFFFRIC_SPEED_OUTSIDE;
    range = last_below(t->speeds, 0, t->ranges, v);
    if (range < 0)
        range = 0;
    X = q / v;
    cell = last_below(t->lower, t->first[range], t->first[range + 1], X);
    if (cell < t->first[range] || !(X <= t->upper[cell]))
        return DIFFFRIC_NOT_DETERMINED;
    width = t->upper[cell] - t->lower[cell];
    xi = 2 * (X - t->lower[cell]) / width - 1;
    tau = 2 * (v - t->speeds[range]) / (t->speeds[range + 1] - t->speeds[range]) - 1;
    for (i = t->tau - 1; i >= 0; --i) {
        const double *c = t->c + ((long)cell * t->tau + i) * t->xi;
        double row = 0.0, steep = 0.0;
        for (j = t->xi - 1; j >= 0; --j) {
            steep = steep * xi + row;
            row = row * xi + c[j];
        }
        y = y * tau + row;
        slope = slope * tau + steep;
    }
    if (!(v * y >= $lowest_answer && v * y <= $highest_answer))
        return DIFFFRIC_OUTSIDE_BOX;
    *mu_s = v * y;
    if (se > 0) {
        const double error = 2 * slope / width * se;
        *variance = error * error;
    }
    return DIFFFRIC_DETERMINED;
}

int difffric_predict(double v, double F_p, double d, double F_p_se, double d_se,
                     difffric_answer *a)
{
    double w_F, w_d;
    int F_known, d_known, F_counts, d_counts;

    a->force = one(&difffric_force, v, F_p, F_p_se, &a->mu_s_force, &a->variance_force);
    a->distance = one(&difffric_distance, v, d, d_se, &a->mu_s_distance, &a->variance_distance);
    F_known = a->variance_force == a->variance_force;
    d_known = a->variance_distance == a->variance_distance;
    F_counts = a->force == DIFFFRIC_DETERMINED && (F_known || !d_known);
    d_counts = a->distance == DIFFFRIC_DETERMINED && (d_known || !F_known);
    w_F = F_counts ? (F_known ? 1 / a->variance_force : 1.0) : 0.0;
    w_d = d_counts ? (d_known ? 1 / a->variance_distance : 1.0) : 0.0;
    a->status = (F_counts ? DIFFFRIC_FORCE : 0) + (d_counts ? DIFFFRIC_DISTANCE : 0);
    a->mu_s = a->variance = NAN;
    if (a->status != DIFFFRIC_NEITHER) {
        a->mu_s = ((F_counts ? w_F * a->mu_s_force : 0.0) + (d_counts ? w_d * a->mu_s_distance : 0.0))
                  / (w_F + w_d);
        if ((F_counts && F_known) || (d_counts && d_known))
            a->variance = 1 / (w_F + w_d);
    }
    return a->status;
}

#ifdef DIFFFRIC_SELFTEST
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#define ROOM 10000

static int same(double is, double expected)
{
    const double off = is > expected ? is - expected : expected - is;
    const double size = expected > 0 ? expected : -expected;
    return (is != is && expected != expected) || off <= 1e-12 * size;
}

int main(int count, char **given)
{
    static double in[ROOM][5];
    char line[1024];
    double x[15], sum = 0.0, seconds;
    int rows = 0, wrong = 0, i, calls = 10000000;
    clock_t begin;
    difffric_answer a;
    FILE *file = count == 2 ? fopen(given[1], "r") : NULL;

    if (file == NULL || fgets(line, sizeof line, file) == NULL) {
        fprintf(stderr, "expected one argument, golden.csv\n");
        return 2;
    }
    while (rows < ROOM && fgets(line, sizeof line, file) != NULL) {
        char *at = line;
        for (i = 0; i < 15; ++i) {
            x[i] = strtod(at, &at);
            if (*at == ',')
                ++at;
        }
        for (i = 0; i < 5; ++i)
            in[rows][i] = x[i];
        ++rows;
        difffric_predict(x[0], x[1], x[2], x[3], x[4], &a);
        if (!(same(a.mu_s, x[6]) && same(a.variance, x[7]) && same(a.mu_s_force, x[8])
              && same(a.variance_force, x[9]) && same(a.mu_s_distance, x[10])
              && same(a.variance_distance, x[11]) && a.status == (int)x[12]
              && a.force == (int)x[13] && a.distance == (int)x[14])
            || (a.status != DIFFFRIC_NEITHER && x[5] == x[5]
                && !(a.mu_s - x[5] <= DIFFFRIC_MAX_ERROR * x[5]
                     && x[5] - a.mu_s <= DIFFFRIC_MAX_ERROR * x[5]))) {
            printf("row %d is wrong: mu_s = %.17g\n", rows, a.mu_s);
            ++wrong;
        }
    }
    fclose(file);
    if (rows == 0) {
        fprintf(stderr, "golden.csv: no rows\n");
        return 2;
    }
    begin = clock();
    for (i = 0; i < calls; ++i) {
        const double *r = in[i % rows];
        sum += difffric_predict(r[0], r[1], r[2], r[3], r[4], &a) + (a.mu_s == a.mu_s ? a.mu_s : 0);
    }
    seconds = (double)(clock() - begin) / CLOCKS_PER_SEC;
    printf("%d of %d rows right; %.1f ns a call (sum %g)\n", rows - wrong, rows,
           1e9 * seconds / calls, sum);
    return wrong > 0;
}
#endif
