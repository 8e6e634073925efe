//
// State_On_Variables.h
//
// Automatically created through MiCASE -- do not change manually!
//
double	since;	///< when
